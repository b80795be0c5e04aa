"""Benches that take less computing than the ones they are made of, and the template of a real one."""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fakes.world.kinematics import ENCODER_RAD
from rig.config import BENCHES, BenchConfig, load_bench

TIP_HZ, WIRE_TIP_HZ = 20.0, 30.0
"""Frames of a fingertip per second: few; and the fewest that a DIGIT offers, as over the wire protocol."""
NOISE_RAD = 10 * ENCODER_RAD
NOISE_M, NOISE_DEG = 0.9 * NOISE_RAD, math.degrees(NOISE_RAD)
"""Largest noise of a simulated arm's reported joint angles and pose: its reach is 0.9 m."""

TEMPLATE = BENCHES.parent / "config" / "new_bench.toml"
ENTERED = (
    ('"ENTER the address of the arm\'s controller"', '"192.0.2.10"'),
    ('"ENTER the address of the gripper"', '"192.0.2.11"'),
    ('"ENTER the serial printed on the sensor on finger B"', '"D20001"'),
    ('"ENTER the serial printed on the sensor on finger C"', '"D20002"'),
    (r'"ENTER the camera\'s device, [^"]*"', '"/dev/video94"'),
    (r'"ENTER [^"]*, as (\[?[-\d., ]*\d\]?)"', r"\2"),
)
"""What a user would enter for each placeholder: addresses reserved for documentation (RFC 5737), a device
that no computer has, and the numbers that the template gives as examples."""


def filled(text: str) -> str:
    """Return the template of a bench file with a value for each placeholder outside comments."""
    for placeholder, value in ENTERED:
        text = re.sub(f"(?m)^([^#\n]*){placeholder}", rf"\g<1>{value}", text)
    return text


def real_bench() -> str:
    """Return the text of a real bench file: the template, filled in."""
    return filled(TEMPLATE.read_text(encoding="utf-8"))


def real_bench_file(folder: Path) -> Path:
    """Write a real bench file and return its path."""
    path = folder / "real_bench.toml"
    path.write_text(real_bench(), encoding="utf-8")
    return path


@contextmanager
def short_phases() -> Iterator[None]:
    """Shorten the times at rest before and after lifts in this process, a quarter of a lift's frames."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("protocols.slip_trial.GRASP_S", 0.5)
        patch.setattr("protocols.slip_trial.HOLD_S", 0.5)
        yield


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
