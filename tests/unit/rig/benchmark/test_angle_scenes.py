"""The two-marker angle in simulated scenes and in real photographs."""

import pytest

from rig.benchmark.calibration import study
from support.marks import heavy


@pytest.mark.heavy
@pytest.mark.parametrize(
    "scene",
    [study.AngleScene(hidden=0.06), *heavy(study.AngleScene(24.0), study.AngleScene(jpeg=80))],
    ids=str,
)
def test_angle_of_a_scene_is_answered_and_accurate(scene: study.AngleScene) -> None:
    assert scene in study.SCENES
    row = study.score_scene(scene, (1,))
    assert row.answered > (0.7 if scene.hidden else 0.95)  # a covered edge is seen, and the picture refused
    assert row.worst_deg >= row.rms_deg > abs(row.rest_deg)
    assert row.rms_deg < 0.05


@pytest.mark.heavy
def test_printed_markers_turn_less_by_edges_in_real_photographs(real_data) -> None:
    limits = study.real_marker_limits(real_data)
    assert not [limit for limit in limits if limit.met is False]  # among them, that every corner is found
    rows = {row.name: row.value for row in limits}
    ours, corners = (value for name, value in rows.items() if name.endswith("deg"))
    assert ours is not None
    assert corners is not None
    assert ours < 0.8 * corners
    assert study.printed_turns(real_data / "opencv_photos", lambda picture, seen: seen) > ours


def test_run_time_of_an_angle_is_printed_and_not_judged() -> None:
    row = study.AngleRow(
        str(study.AngleScene()), rms_deg=0.01, worst_deg=0.02, rest_deg=0.0, answered=1.0, ms=50.0
    )
    limits = {limit.name: limit for limit in study.marker_limits([row], None)}
    time = limits["angle: median per frame, ms of processor time"]
    assert (time.value, time.met) == (50.0, None)
    assert not [limit for limit in limits.values() if limit.met is False]
