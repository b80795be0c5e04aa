"""Public objects describe themselves in one line, with arrays by shape and type."""

import re

import numpy as np
import pytest

import rig
from drivers.types import Frame
from rig.tactile.sample import State

IMAGE = np.zeros((320, 240, 3), np.uint8)
CURVE = np.linspace(0.0, 1.0, 500)
EXAMPLES = {
    "Frame": Frame(IMAGE, 1_000, 3, "D20001", b"\xff" * 5_000),
    "SlipSample": rig.SlipSample(
        1_000, State.TRACKING, 1 / 3, 0.1, stage_s={f"{i}": i / 7 for i in range(12)}, skipped=("a",) * 12
    ),
    "SensorFrame": rig.SensorFrame(0.25, IMAGE, IMAGE[:, :, 0]),
    "Angles": rig.Angles(CURVE, CURVE, CURVE, ("tracking",) * 500),
    "ArmTrack": rig.ArmTrack(CURVE, np.zeros((500, 4, 4)), np.zeros((500, 6))),
    "WrenchTrack": rig.WrenchTrack(CURVE, np.zeros((500, 3)), np.zeros((500, 3))),
    "GripperTrack": rig.GripperTrack(CURVE, CURVE, CURVE, CURVE > 0.5),
    "MarkerTrack": rig.MarkerTrack(CURVE, np.zeros((500, 2, 4, 2))),
    "Score": rig.Score(1 / 3, 1 / 7, 2 / 3, 500, 1.0, 0.95),
    "CameraSolution": rig.CameraSolution(
        (640, 480), np.eye(3), np.zeros(8), {f"k{i}": i / 7 for i in range(12)}, 1 / 3, 2 / 3, "weak",
        ("few views",), dict.fromkeys(range(20), "contradicts the others"),
    ),
    "HandEyeSolution": rig.HandEyeSolution(
        np.eye(4), np.eye(4), np.ones(3), np.ones(3), "good", (), dict.fromkeys(range(20), "contradicts")
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EXAMPLES)
def test_repr_is_one_short_line(name: str) -> None:
    shown = repr(EXAMPLES[name])
    assert shown.startswith(f"{name}(")
    assert "\n" not in shown
    assert len(shown) <= 260
    assert not re.search(r"\.\d{7}", shown)
