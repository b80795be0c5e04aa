"""The gripper's opening over counts, and the tip of a tool: correct, or refused with the reason."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.gripper import Direction, OpeningSample, calibrate_opening, calibrate_pivot
from calibration.verdict import Verdict
from drivers.types import Pose
from rig.calibrate.gripper import GripperOptions, solve_openings
from rig.calibrate.kind import Samples
from support.motions import ORDERS, jittered, pivot_scene
from support.units import IN_MM, units


def openings(
    noise_m: float = 0.0, lag_m: float = 0.0, counts: range = range(10, 210, 20)
) -> list[OpeningSample]:
    rng = np.random.default_rng(0)
    made = []
    for direction, offset in ((Direction.CLOSING, 0.0), (Direction.OPENING, lag_m)):
        for count in counts:
            opening = 0.12 - 0.0005 * count - 1e-7 * count**2 + rng.normal(0, noise_m) + offset * count / 190
            made.append(OpeningSample(f"{direction}{count}", count, opening, direction))
    return made


def test_opening_table_is_monotone_and_hysteresis_is_measured() -> None:
    found = calibrate_opening(openings(5e-5, 7e-4))
    assert found.assessment.verdict is Verdict.GOOD
    assert found.hysteresis_m == pytest.approx(7e-4, abs=2e-4)
    counts, opening_m = found.tables[Direction.CLOSING]
    assert (np.diff(opening_m) <= 0).all()
    assert opening_m[list(counts).index(90)] == pytest.approx(0.12 - 0.0005 * 90 - 1e-7 * 90**2, abs=3e-4)


@pytest.mark.parametrize(
    ("way", "verdict", "said"),
    [(Direction.CLOSING, Verdict.WEAK, "hysteresis is unknown"),
     (Direction.OPENING, Verdict.REFUSED, "0 usable measurements while closing")],
)  # fmt: skip
def test_opening_measured_in_one_direction(way: Direction, verdict: Verdict, said: str) -> None:
    found = calibrate_opening([s for s in openings() if s.direction is way])
    assert found.assessment.verdict is verdict
    assert said in found.assessment.reasons[0]


def test_bad_opening_is_left_out_and_named() -> None:
    for counts, opening_m in ((300.0, 0.05), (100.0, 50.0), (100.0, float("nan"))):
        bad = OpeningSample("bad", counts, opening_m, Direction.CLOSING)
        found = calibrate_opening([bad, *openings()])
        assert [rejected.id for rejected in found.rejected] == ["bad"]
        assert np.interp(110.0, *found.tables[Direction.CLOSING]) == pytest.approx(0.06379, abs=1e-6)


@pytest.mark.parametrize("apart", [0.0, 0.1, 0.3])
def test_repeated_openings_do_not_make_a_table_of_few_positions_good(apart: float) -> None:
    counts = [c + apart * k for c in (10, 100, 200) for k in range(3)]
    samples = [
        OpeningSample(f"{way}{i}", c, 0.14 - 5e-4 * c, way) for way in Direction for i, c in enumerate(counts)
    ]
    assert "3 counts measured; 8 are good" in calibrate_opening(samples).assessment.reasons
    two = calibrate_opening([s for s in samples if s.counts < 150])
    assert two.assessment.verdict is Verdict.REFUSED


TABLES = [(0.25, range(10, 230, 24)), (0.6, range(100, 160, 8)), (0.9, range(10, 150, 14))]
"""mm per count of a gripper, and measured counts."""


@pytest.mark.heavy
@units
def test_gripper_table_of_another_unit_is_refused_and_one_in_mm_is_accepted(
    unit: str, tmp_path: Path
) -> None:
    for mm_per_count, counts in TABLES:
        for scale in (IN_MM[unit], 1.0):
            rows = [
                f"{c},{(150 - mm_per_count * (c - 6)) * scale:.7g},{way}" for way in Direction for c in counts
            ]
            (tmp_path / "gripper.csv").write_text("\n".join(["counts,opening_mm,direction", *rows]))
            found = solve_openings(Samples(tmp_path), GripperOptions())
            if scale == 1.0:
                assert found.assessment.verdict is Verdict.GOOD, found.assessment
            else:
                assert unit in found.assessment.refusals[0].split("; in ")[1]
                assert not found.value


def test_unit_is_checked_against_the_range_of_the_gripper() -> None:
    small = [OpeningSample(f"{c}", c, 0.016 - 6e-5 * c, Direction.CLOSING) for c in range(10, 250, 20)]
    assert "in cm or inches?" in str(calibrate_opening(small).assessment)
    assert calibrate_opening(small, step_m=0.016 / 255).assessment.verdict is Verdict.WEAK


def test_pivot_is_within_its_sigma_and_a_slipped_sample_is_rejected() -> None:
    tip, poses = pivot_scene(np.random.default_rng(0), 14)
    poses[3] = ("slipped", poses[3][1].translated(x_m=0.01))
    found = calibrate_pivot(poses)
    assert found.tip_m is not None
    assert found.covariance is not None
    off = found.tip_m - tip
    assert np.linalg.norm(off) < 1e-3
    assert off @ np.linalg.solve(found.covariance, off) < 20.0
    assert [r.id for r in found.rejected] == ["slipped"]


def in_unit(unit: str, pose: Pose) -> Pose:
    """Return a pose whose position is given in another unit than m."""
    return Pose.from_rotation(1e3 * IN_MM[unit] * np.asarray(pose.position_m), pose.rotation)


def test_motions_that_do_not_determine_the_tip_are_refused_with_the_reason() -> None:
    rng = np.random.default_rng(4)
    about_z = np.outer(rng.uniform(-0.8, 0.8, 12), [0, 0, 1])
    _, far = pivot_scene(rng, 12)
    cases = {
        "the tool rotated by at most": pivot_scene(
            rng, 12, Rotation.from_rotvec(rng.normal(0, 0.02, (12, 3)))
        )[1],
        "about one axis": pivot_scene(rng, 12, Rotation.from_rotvec(about_z))[1],
        "3 usable distinct poses": pivot_scene(rng, 3)[1],
        "0 usable distinct poses": [(name, in_unit("micrometres", pose)) for name, pose in far],
    }
    for reason, poses in cases.items():
        found = calibrate_pivot(poses)
        assert reason in str(found.assessment)
        assert found.tip_m is None


@pytest.mark.parametrize("unit", ["cm", "inches"])
def test_pivot_in_another_unit_is_refused(unit: str) -> None:
    _, poses = pivot_scene(np.random.default_rng(0), 12)
    found = calibrate_pivot([(name, in_unit(unit, pose.translated(x_m=0.3))) for name, pose in poses])
    assert found.assessment.verdict is Verdict.REFUSED
    assert found.tip_m is None


@pytest.mark.parametrize("jitter", [0.0, 1.0], ids=["exact", "with the robot's noise"])
@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
def test_repeated_poses_of_the_pivot_count_once(order: Callable[[int], list[int]], jitter: float) -> None:
    rng = np.random.default_rng(0)
    _, poses = pivot_scene(rng, 10)
    again = [(f"{i:03d}", jittered(poses[k][1], rng, jitter)) for i, k in enumerate(order(10))]
    assert len(calibrate_pivot(again).residual_m or {}) <= 10
