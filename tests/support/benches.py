"""Benches that take less computing than the ones they are made of."""

from rig.config import BenchConfig, load_bench

TIP_HZ, WIRE_TIP_HZ = 20.0, 30.0
"""Frames of a fingertip per second: few; and the fewest that a DIGIT offers, as over the wire protocol."""


def lighter(name: str = "fake", tip_hz: float | None = None) -> BenchConfig:
    """Return a bench with fewer frames of the fingertips and a quarter of the camera's pixels.

    An arm over the wire protocol reports its state a quarter as often. Lifts are simulated in less than
    half the time, and only precision needs the rest.
    """
    bench = load_bench(name)
    rate_hz = tip_hz or (TIP_HZ if bench.in_process else WIRE_TIP_HZ)
    slower = tuple(tip.model_copy(update={"rate_hz": rate_hz}) for tip in bench.tactile)
    width, height = bench.camera.size_px
    small = {"size_px": (width // 2, height // 2), "focal_px": bench.camera.focal_px / 2.0}
    camera = bench.camera.model_copy(update=small)
    arm = bench.arm if bench.in_process else bench.arm.model_copy(update={"frequency_hz": 125.0})
    return bench.model_copy(update={"tactile": slower, "camera": camera, "arm": arm})
