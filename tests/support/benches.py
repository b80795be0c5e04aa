"""Benches that take less computing than the ones they are made of."""

from rig.config import BenchConfig, load_bench


def lighter(name: str = "fake") -> BenchConfig:
    """Return a bench with half the fingertips' frames and a quarter of the camera's pixels.

    An arm behind wires says a quarter as often where it is. Lifts are simulated in less than half the
    time; nothing but precision needs the rest.
    """
    bench = load_bench(name)
    slower = tuple(t.model_copy(update={"rate_hz": t.rate_hz / 2.0}) for t in bench.tactile)
    width, height = bench.camera.size_px
    small = {"size_px": (width // 2, height // 2), "focal_px": bench.camera.focal_px / 2.0}
    camera = bench.camera.model_copy(update=small)
    arm = bench.arm if bench.in_process else bench.arm.model_copy(update={"frequency_hz": 125.0})
    return bench.model_copy(update={"tactile": slower, "camera": camera, "arm": arm})
