"""The two-marker angle beside two other methods on the same pictures."""

import pytest

from rig.benchmark.calibration.angle_scenes import SCENES, AngleScene, score_scene
from rig.benchmark.calibration.markers import printed_turns, real_marker_limits


@pytest.mark.parametrize("scene", [AngleScene(24.0), AngleScene(jpeg=80), AngleScene(hidden=0.06)], ids=str)
def test_own_method_is_the_best_of_three_on_the_same_pictures(scene: AngleScene) -> None:
    assert scene in SCENES
    row = score_scene(scene, (1,))
    corners, by_size, ours = row.corners, row.by_size, row.ours
    assert ours.rms_deg < 1.05 * min(corners.rms_deg, by_size.rms_deg)
    assert ours.rms_deg < 0.6 * corners.rms_deg
    assert ours.answered >= max(corners.answered, by_size.answered)
    assert ours.worst_deg >= ours.rms_deg > abs(ours.rest_deg)


def test_printed_markers_turn_less_by_edges_in_real_photographs(real_data) -> None:
    rows = {row.name: row.value for row in real_marker_limits(real_data)}
    ours, corners = (value for name, value in rows.items() if name.endswith("deg"))
    assert ours is not None
    assert corners is not None
    assert ours < 0.8 * corners
    assert printed_turns(real_data / "opencv_photos", lambda picture, seen: seen) > ours
