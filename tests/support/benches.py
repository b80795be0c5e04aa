"""Benches that take less computing than the ones they are made of."""

from rig.config import BenchConfig, load_bench


def with_half_the_frames(name: str = "fake") -> BenchConfig:
    """Return a bench with its fingertips at half their rate: lifts are simulated in half the time."""
    bench = load_bench(name)
    slower = tuple(t.model_copy(update={"rate_hz": t.rate_hz / 2.0}) for t in bench.tactile)
    return bench.model_copy(update={"tactile": slower})


def with_small_pictures(bench: BenchConfig) -> BenchConfig:
    """Return a bench whose camera has the same view with half as many pixels a side."""
    width, height = bench.camera.size_px
    small = {"size_px": (width // 2, height // 2), "focal_px": bench.camera.focal_px / 2.0}
    return bench.model_copy(update={"camera": bench.camera.model_copy(update=small)})
