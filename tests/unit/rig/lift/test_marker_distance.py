"""A distance to the markers that contradicts the camera's position is reported in row, log and page."""

from pathlib import Path

import numpy as np
import pytest

from calibration.camera.model import CameraModel
from calibration.markers.angle import fit_plane
from calibration.store import CalibrationFile, save
from calibration.verdict import Assessment
from drivers.types import Pose
from fakes.camera.marker_scene import MarkerScene
from rig.config import BenchConfig
from rig.config.calibrations import find_calibrations
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.lift.agreement import distance_warning
from rig.report.advice import trial_notices
from rig.report.session import read_trial
from rig.results.notes import lift_note
from rig.sessions.records import MarkerDistance
from rig.sessions.rows import read_finished_lifts
from rig.sessions.session import read_manifest
from rig.tactile.estimators import choose_estimator
from support.benches import short_phases


def test_marker_side_and_intrinsics_give_the_distance() -> None:
    scene = MarkerScene(focal_px=700, unit_seed=1)
    place = (0.05, -0.03, 0.75)
    tilted = Pose(place, (np.sin(0.8), 0.0, 0.0, np.cos(0.8)))
    corners = scene.exact_corners_px(tilted)
    rng = np.random.default_rng(0)
    still = corners + rng.normal(0, 0.05, (12, *corners.shape))
    known = fit_plane(still, CameraModel(scene.size, scene.camera_matrix, scene.distortion))
    assert known.distance_sides is not None
    assert 0.04 * known.distance_sides == pytest.approx(np.linalg.norm(place), rel=0.01)
    assert fit_plane(still).distance_sides is None


@pytest.mark.parametrize(
    ("part", "off"), [(0.98, False), (1.08, False), (1.12, True), (0.88, True), (None, False)]
)
def test_distance_warning_begins_at_ten_percent(
    light_bench: BenchConfig, part: float | None, off: bool
) -> None:
    side_m, placed_m = light_bench.camera.marker_side_m, light_bench.object_distance_m()
    sides = part and part * placed_m / side_m
    found = MarkerDistance(side_m * sides, placed_m) if off and sides else None
    assert distance_warning(light_bench, sides) == found


@pytest.mark.heavy
def test_displaced_camera_is_warned_of_in_terminal_log_and_report(
    light_bench: BenchConfig, tmp_path: Path
) -> None:
    stands = light_bench.camera.base_T_camera()
    nearer = {
        "setup": "eye-to-hand", "translation_m": stands.translated(y_m=0.12).position_m,
        "quaternion_xyzw": stands.quaternion_xyzw,
    }  # fmt: skip
    serials = {"camera": "SIM-C0001"}
    created = "2026-11-01T00:00:00+00:00"
    file = CalibrationFile("hand-eye", serials, nearer, Assessment(), created, inputs={"simulated": True})
    save(file, tmp_path / "hand-eye-SIM-C0001.yaml")
    wrong = light_bench.model_copy(update={"calibrations": find_calibrations(light_bench, tmp_path)})
    folder = tmp_path / "s"
    with short_phases():
        run_trial(folder, TrialSettings(wrong, 0, choose_estimator("pca")), ["t1"], 1)
    row = read_finished_lifts(folder)[0]
    said = row.marker_distance
    assert said is not None
    assert said.seen_m == pytest.approx(0.63, abs=0.01)
    assert said.placed_m == pytest.approx(0.51, abs=0.01)
    assert f"WARNING: {said}" in lift_note(row)
    assert f"WARNING lift t1/1: {said}" in (folder / "log.txt").read_text()
    trial = read_trial(folder, read_manifest(folder))
    notices = [notice for notice in trial_notices(trial) if str(said) in notice.what]
    assert [notice.level for notice in notices] == ["warn"]
