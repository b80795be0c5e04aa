"""Benches that take less computing than the ones they are made of."""

from rig.config import BenchConfig, load_bench


def lighter(name: str = "fake", tip_hz: float = 20.0) -> BenchConfig:
    """Return a bench with fewer frames of the fingertips and a quarter of the camera's pixels.

    An arm over the wire protocol reports its state a quarter as often. Lifts are simulated in less than
    half the time, and only precision needs the rest.
    """
    bench = load_bench(name)
    slower = tuple(tip.model_copy(update={"rate_hz": tip_hz}) for tip in bench.tactile)
    width, height = bench.camera.size_px
    small = {"size_px": (width // 2, height // 2), "focal_px": bench.camera.focal_px / 2.0}
    camera = bench.camera.model_copy(update=small)
    arm = bench.arm if bench.in_process else bench.arm.model_copy(update={"frequency_hz": 125.0})
    return bench.model_copy(update={"tactile": slower, "camera": camera, "arm": arm})
