"""Benches that take less computing than the ones they are made of."""

from rig.config import BenchConfig, load_bench


def lighter(name: str = "fake") -> BenchConfig:
    """Return a bench with fingertips at half their rate and a camera with a quarter of its pixels.

    Its lifts are simulated in less than half the time; nothing but precision needs the others.
    """
    bench = load_bench(name)
    slower = tuple(t.model_copy(update={"rate_hz": t.rate_hz / 2.0}) for t in bench.tactile)
    width, height = bench.camera.size_px
    small = {"size_px": (width // 2, height // 2), "focal_px": bench.camera.focal_px / 2.0}
    camera = bench.camera.model_copy(update=small)
    return bench.model_copy(update={"tactile": slower, "camera": camera})
