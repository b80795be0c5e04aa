"""Tables in another unit than their header states: refused, with the unit that would fit."""

from pathlib import Path

import numpy as np
import pytest

from calibration.gripper import Direction, OpeningSample, calibrate_opening, calibrate_pivot
from calibration.poses import pose_fault
from calibration.time_offset import make_stream
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from drivers.types import Pose
from rig.calibrate.gripper import gripper_from_folder
from support.motions import pivot_scene
from support.units import IN_MM, units


@units
@pytest.mark.parametrize(
    ("mm_per_count", "counts"),
    [(0.25, range(10, 230, 24)), (0.6, range(100, 160, 8)), (0.9, range(10, 230, 24))],
)
def test_gripper_table_of_another_unit_is_refused(
    unit: str, mm_per_count: float, counts: range, tmp_path: Path
) -> None:
    rows = [
        f"{c},{(150 - mm_per_count * (c - 6)) * IN_MM[unit]:.7g},{way}" for way in Direction for c in counts
    ]
    (tmp_path / "gripper.csv").write_text("\n".join(["counts,opening_mm,direction", *rows]))
    found = gripper_from_folder(tmp_path, "G1")
    assert found.assessment.verdict is Verdict.REFUSED
    assert unit in str(found.assessment).split("; in ")[1]
    assert not found.value


@pytest.mark.parametrize("mm_per_count", [0.25, 0.6, 0.9])
def test_gripper_table_in_mm_is_accepted(mm_per_count: float) -> None:
    samples = [
        OpeningSample(f"{way}{c}", c, 0.15 - 1e-3 * mm_per_count * (c - 6), way)
        for way in Direction
        for c in range(10, 150, 14)
    ]
    assert calibrate_opening(samples).assessment.verdict is Verdict.GOOD


def test_unit_is_checked_against_the_range_of_the_gripper() -> None:
    small = [OpeningSample(f"{c}", c, 0.016 - 6e-5 * c, Direction.CLOSING) for c in range(10, 250, 20)]
    assert "in cm or inches?" in str(calibrate_opening(small).assessment)
    assert calibrate_opening(small, step_m=0.016 / 255).assessment.verdict is Verdict.WEAK


@units
def test_robot_poses_of_another_unit_are_rejected(unit: str) -> None:
    scale = IN_MM[unit] * 1e3
    pose = Pose((0.45 * scale, -0.2 * scale, 0.3 * scale))
    reason = pose_fault(pose, "robot pose", 5.0)
    assert reason is None if unit == "metres" else unit in str(reason).split("; in ")[1]


@pytest.mark.parametrize("unit", ["cm", "inches", "micrometres"])
def test_pivot_in_another_unit_is_refused(unit: str) -> None:
    scale = IN_MM[unit] * 1e3
    _, poses = pivot_scene(np.random.default_rng(0), 12)
    moved = [
        (name, Pose(tuple(scale * np.add(p.position_m, (0.3, 0, 0))), p.quaternion_xyzw)) for name, p in poses
    ]
    found = calibrate_pivot(moved)
    assert found.assessment.verdict is Verdict.REFUSED
    assert found.tip_m is None


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e-3, "microseconds or ms"), (1e-6, "microseconds or ms"), (1e3, "in ms?"), (60.0, "in ms?")],
    ids=["us as ns", "ms as ns", "ms as s", "seconds as minutes"],
)
@pytest.mark.parametrize("rate_hz", [30, 60, 500])
def test_times_of_another_unit_are_refused(factor: float, said: str, rate_hz: int) -> None:
    times = (np.arange(20 * rate_hz) * 1e9 / rate_hz * factor).astype(np.int64)
    if factor == 60.0 and rate_hz > 30:
        pytest.skip("such a stream could be one of 1 to 8 Hz")
    with pytest.raises(CalibrationError, match=said.replace("?", r"\?")):
        make_stream(times, np.sin(np.arange(len(times))), "camera")
