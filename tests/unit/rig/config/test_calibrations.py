"""Calibrations beside a bench file are found, checked and used, also in a replay."""

import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.camera.files import camera_info
from calibration.camera.model import CameraModel
from calibration.gel.look import GelLook
from calibration.gel.noise import CameraNoise
from calibration.store import CalibrationFile, save
from calibration.verdict import Assessment
from drivers.errors import CalibrationError
from rig.calibrate.kinds import compare_files
from rig.config import BenchConfig, load_bench
from rig.config.calibrations import find_calibrations, load_calibrated_bench
from rig.config.devices import DigitConfig, GripperLimitsConfig
from rig.config.load import BENCHES
from rig.experiments.lift_plan import TrialSettings, stored_trial
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.results.summary import summarize_trial
from rig.sessions.manifest import RecordManifest, begun_on, read_manifest
from rig.sessions.records import POSES
from rig.sessions.rows import read_lifts
from rig.sessions.session import open_session
from rig.tactile.estimators import choose_estimator
from support.benches import short_phases

CAMERA = CameraModel(
    (640, 480), np.array([[650.0, 0, 321], [0, 651.0, 238], [0, 0, 1]]), np.array([0.01, 0, 0, 0, 0])
)
SYNC = {"reference": "arm", "stream": "SIM-C0001"}
CAMERA_SERIAL, GRIPPER = {"camera": "SIM-C0001"}, {"gripper": "fake"}
PLACE = {"setup": "eye-to-hand", "translation_m": [0.4, -0.6, 0.2], "quaternion_xyzw": [1.0, 0, 0, 0]}


def keep(
    folder: Path, kind: str, serials: dict, value: dict, refused: str = "", simulated: bool = True,
    quality: dict | None = None,
) -> Path:  # fmt: skip
    assessment = Assessment(refusals=(refused,)) if refused else Assessment()
    path = folder / f"{'-'.join([kind, *serials.values()])}.yaml"
    created = datetime.now(UTC).isoformat(timespec="seconds")
    made = {"simulated": simulated}
    save(CalibrationFile(kind, serials, value, assessment, created, quality or {}, inputs=made), path)
    return path


def test_calibration_files_are_used_and_announced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "calibrations"
    keep(folder, "camera", {"camera": "SIM-C0001"}, camera_info(CAMERA, "SIM-C0001"))
    keep(folder, "tactile", {"tactile": "SIM-D0002"}, {"pixel_aspect": 0.97})
    keep(folder, "sync", {"reference": "arm", "stream": "SIM-C0001"}, {"add_to_stream_s": -0.004})
    keep(folder, "hand-eye", CAMERA_SERIAL, PLACE)
    monkeypatch.chdir(tmp_path)
    assert not find_calibrations(load_bench("fake"), tmp_path / "nothing").files
    said: list[str] = []
    bench = load_calibrated_bench("fake", said.append)
    assert len(said) == 4
    assert all("0 hours old, good" in line for line in said)
    assert bench.camera_model().matrix[0, 0] == 650.0
    assert bench.base_T_camera().position_m == (0.4, -0.6, 0.2)
    assert bench.pixel_aspects() == {"SIM-D0001": 0.978, "SIM-D0002": 0.97}
    assert bench.calibrations.time_shift_s == {"SIM-C0001": -0.004}
    plain = load_bench("fake")
    assert plain.camera_model().matrix[0, 0] == plain.camera.focal_px
    assert plain.base_T_camera() == plain.camera.base_T_camera()
    assert bench != plain


def test_uncertainty_of_camera_and_hand_eye_is_used(tmp_path: Path) -> None:
    lens = {"terms": ["fx", "fy"], "covariance": [[4.0, 1.0], [1.0, 4.0]]}
    keep(tmp_path, "camera", CAMERA_SERIAL, camera_info(CAMERA, "SIM-C0001"), quality=lens)
    turns = np.diag([1e-6, 4e-6, 1e-6, 1e-8, 1e-8, 1e-8]).tolist()
    keep(tmp_path, "hand-eye", CAMERA_SERIAL, PLACE, quality={"covariance": turns})
    found = find_calibrations(load_bench("fake"), tmp_path)
    known = load_bench("fake").model_copy(update={"calibrations": found}).camera_model().uncertainty
    assert known is not None
    assert known.terms == (0, 1)
    assert known.covariance.tolist() == lens["covariance"]
    assert found.camera_turn_sigma_rad == pytest.approx(0.002)


def tip_from_tcp(bench: BenchConfig, away_m: float) -> dict[str, object]:
    """The value of a clamped tip that stands out of the TCP along the tool's z axis."""
    tcp = bench.arm.flange_T_tcp()
    tip = tcp.translated(*tcp.rotation.apply((0.0, 0.0, away_m)))
    return {"translation_m": list(tip.position_m)}


@pytest.mark.parametrize(
    ("away_m", "before_m", "refused"), [(0.03, 0.03, False), (0.06, 0.03, True), (0.06, 0.06, False)]
)
def test_tcp_further_from_the_clamped_tip_than_was_accepted_is_refused(
    away_m: float, before_m: float, refused: bool, tmp_path: Path
) -> None:
    bench, said = load_bench("fake"), []
    value = {**tip_from_tcp(bench, away_m), "tip_from_tcp_m": [0.0, 0.0, before_m]}
    keep(tmp_path, "tcp", {"tool": "fake"}, value)
    if refused:
        with pytest.raises(
            CalibrationError, match=r"60\.0 mm from tcp_m.*correct tcp_m, or move the file away"
        ):
            find_calibrations(bench, tmp_path, said.append)
    else:
        assert list(find_calibrations(bench, tmp_path, said.append).files) == ["tcp-fake"]
        assert f"is {1e3 * away_m:.1f} mm from tcp_m" in said[0]


def test_calibrations_that_cannot_be_used_are_left_out_and_named(tmp_path: Path) -> None:
    bench = load_bench("fake")
    for name, kind, serials, value, refused in (
        ("tip", "tcp", {"tool": "fake"}, tip_from_tcp(bench, 0.4), ""),
        ("on the tool", "hand-eye", CAMERA_SERIAL, {**PLACE, "setup": "eye-in-hand"}, ""),
        ("refused", "camera", CAMERA_SERIAL, {}, "square-on views only"),
    ):
        (tmp_path / name).mkdir()
        keep(tmp_path / name, kind, serials, value, refused=refused)
        said: list[str] = []
        assert not find_calibrations(bench, tmp_path / name, said.append).files
        assert ["calibration not used" in line and refused in line for line in said] == [True]


def test_fixed_camera_and_camera_on_the_tool_are_not_compared(tmp_path: Path) -> None:
    files = []
    for setup in ("eye-to-hand", "eye-in-hand"):
        (tmp_path / setup).mkdir()
        value = {**PLACE, "setup": setup, "target": PLACE}
        files.append(keep(tmp_path / setup, "hand-eye", CAMERA_SERIAL, value))
    assert compare_files(files[0], files[0])["move_mm"] == 0.0
    with pytest.raises(CalibrationError, match="one is eye-to-hand, the other eye-in-hand"):
        compare_files(*files)


def test_camera_calibration_of_another_serial_or_image_size_is_rejected(tmp_path: Path) -> None:
    path = keep(tmp_path, "camera", {"camera": "OTHER"}, camera_info(CAMERA, "OTHER"))
    for name in ("camera-OTHER.yaml", "camera-SIM-C0001.yaml"):
        path = path.rename(tmp_path / name)
        with pytest.raises(CalibrationError, match="belongs to camera OTHER, the bench has SIM-C0001"):
            find_calibrations(load_bench("fake"), tmp_path)
    larger = CameraModel((1280, 720), CAMERA.matrix, CAMERA.distortion)
    keep(tmp_path, "camera", CAMERA_SERIAL, camera_info(larger, "SIM-C0001"))
    said = r"\(1280, 720\) px, but the bench file has size_px = \[640, 480\]"
    with pytest.raises(CalibrationError, match=said):
        find_calibrations(load_bench("fake"), tmp_path)


@pytest.mark.parametrize(
    ("kind", "serials", "value", "said"),
    [
        ("tactile", {"tactile": "SIM-D0001"}, {"pixel_aspect": 0.4}, "must be from 0.5 to 2, found 0.4"),
        ("tactile", {"tactile": "SIM-D0001"}, {"pixel_aspect": 2.5}, "must be from 0.5 to 2"),
        ("tactile", {"tactile": "SIM-D0001"}, {"pixel_aspect": 10**30}, "a number of 31 digits"),
        ("sync", SYNC, {"add_to_stream_s": 1e308}, "must be from -1 to 1"),
        ("sync", SYNC, {"add_to_stream_s": "soon"}, "damaged"),
        ("hand-eye", CAMERA_SERIAL, {**PLACE, "quaternion_xyzw": [1.0, 1.0, 0.0, 0.0]}, "length 1.414"),
        ("hand-eye", CAMERA_SERIAL, {**PLACE, "quaternion_xyzw": [0.0] * 4}, "length 0, not 1"),
        ("hand-eye", CAMERA_SERIAL, {**PLACE, "translation_m": [400.0, 0.0, 0.0]}, "m are needed"),
        ("hand-eye", CAMERA_SERIAL, {**PLACE, "translation_m": [[1.0], {}, None]}, "damaged"),
        ("gripper", GRIPPER, {"closing": {"counts": [6, 255], "opening_m": [12.0, 0.0]}}, "from -0.2 to 0.2"),
        ("gripper", GRIPPER, {"closing": {"counts": [6, 50, 255], "opening_m": [0.1, 0.12, 0]}}, "decrease"),
        ("gripper", GRIPPER, {"closing": {"counts": [50, 6], "opening_m": [0.1, 0.0]}}, "decrease from 50"),
        ("gripper", GRIPPER, {"closing": {"counts": [6], "opening_m": [0.1, 0.0]}}, "damaged"),
    ],
)  # fmt: skip
def test_impossible_calibration_values_are_rejected(
    tmp_path: Path, kind: str, serials: dict, value: dict, said: str
) -> None:
    path = keep(tmp_path, kind, serials, value)
    with pytest.raises(CalibrationError) as raised:
        find_calibrations(load_bench("fake"), tmp_path)
    assert str(raised.value).startswith(f"{path}: ")
    assert said in str(raised.value)
    assert len(str(raised.value)) < len(str(path)) + 250


def test_yaml_aliases_that_expand_to_gigabytes_are_rejected(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 9)]
    path = tmp_path / "tactile-SIM-D0001.yaml"
    path.write_text("\n".join([*lines, "calibration: *a8", ""]))
    assert path.stat().st_size < 600
    with pytest.raises(CalibrationError, match=r"line 2: an alias, \*a0: write it out"):
        find_calibrations(load_bench("fake"), tmp_path)


def test_measured_openings_are_extrapolated_with_the_nominal_slope() -> None:
    limits = GripperLimitsConfig(min_counts=6, max_opening_m=0.120, opening_per_count_m=0.0006)
    spec = limits.spec(((50.0, 0.090), (100.0, 0.065), (150.0, 0.030)))
    for counts, opening_m in ((100, 0.065), (125, 0.0475), (40, 0.096), (160, 0.024)):
        assert 6 + spec.step_at(opening_m) == counts


def calibrated(bench: BenchConfig, folder: Path) -> BenchConfig:
    """Return a bench with a file of each kind that changes a lift. A camera 20 ms late is another truth."""
    camera = CameraModel(bench.camera.size_px, np.diag([327.5, 327.5, 1.0]) + CENTRE, np.zeros(5))
    keep(folder, "camera", CAMERA_SERIAL, camera_info(camera, "SIM-C0001"))
    keep(folder, "sync", SYNC, {"add_to_stream_s": 0.02})
    keep(folder, "tactile", {"tactile": "SIM-D0001"}, {"pixel_aspect": 1.0})
    keep(folder, "gripper", GRIPPER, {"closing": {"counts": [6, 250], "opening_m": [0.120, -0.0319]}})
    return bench.model_copy(update={"calibrations": find_calibrations(bench, folder)})


CENTRE = np.array([[0.0, 0.0, 160.0], [0.0, 0.0, 120.0], [0.0, 0.0, 0.0]])


@pytest.mark.heavy
def test_lift_with_calibrations_replays_identically_without_the_original_files(
    light_bench: BenchConfig, two_lifts: Path, tmp_path: Path
) -> None:
    bench = calibrated(light_bench, tmp_path / "calibrations")
    with short_phases():
        done = run_trial(tmp_path / "s", TrialSettings(bench, 0, choose_estimator("pca")), ["t2"], 1)
    assert done.mare != summarize_trial(read_lifts(two_lifts)[:1]).mare
    shutil.rmtree(tmp_path / "calibrations")
    assert run_replay(stored_trial(tmp_path / "s"), jobs=1).agreement == (1, 1, 0.0)


def test_session_stores_the_files_and_refuses_a_changed_one(light_bench: BenchConfig, tmp_path: Path) -> None:
    bench = calibrated(light_bench, tmp_path / "calibrations")
    wanted = RecordManifest(**vars(begun_on(bench, "record", 0, ["7"])), poses=1, images=1)
    open_session(tmp_path / "s", wanted, POSES, resume=False).close()
    stored = sorted((tmp_path / "s" / "calibrations").iterdir())
    assert [path.name for path in stored] == [
        "camera-SIM-C0001.yaml", "gripper-fake.yaml", "sync-arm-SIM-C0001.yaml", "tactile-SIM-D0001.yaml",
    ]  # fmt: skip
    assert all(path.read_bytes() == (tmp_path / "calibrations" / path.name).read_bytes() for path in stored)
    again = read_manifest(tmp_path / "s")
    assert again.config == wanted.config
    assert again.config.camera_model().matrix.tolist() == bench.camera_model().matrix.tolist()
    open_session(tmp_path / "s", wanted, POSES, resume=True).close()
    stored[0].write_text(stored[0].read_text().replace("327.5", "300.0"))
    with pytest.raises(CalibrationError, match=r"camera-SIM-C0001\.yaml: is not the file that session\.json"):
        read_manifest(tmp_path / "s").config.camera_model()


def with_gel(folder: Path, name: str, simulated: bool = True) -> BenchConfig:
    """Return the bench `fake` whose first fingertip names a calibration with a look of two terms."""
    path = keep(folder, "tactile", {"tactile": "D20641"}, {"look": "own.npz"}, simulated=simulated)
    weights, noise = np.arange(27.0).reshape(9, 3), CameraNoise.independent(np.diag([4.0, 1.0, 9.0]))
    background = np.full((320, 240, 3), 90.0, np.float32)
    look = GelLook(background, weights, 0, False, False, (0.05, 0.06), noise, None)
    (folder / "own.npz").write_bytes(look.pack())
    text = (BENCHES / "fake.toml").read_text().replace('finger = "B"', f'finger = "B"\ngel = "{path.name}"')
    (folder / name).write_text(text)
    return load_bench(str(folder / name))


def test_gel_named_in_the_bench_file_is_stored_for_a_replay(tmp_path: Path) -> None:
    with_gel(tmp_path, "bench.toml")
    bench = load_calibrated_bench(str(tmp_path / "bench.toml"), lambda _: None)
    wanted = RecordManifest(**vars(begun_on(bench, "record", 0, ["7"])), poses=1, images=1)
    open_session(tmp_path / "s", wanted, POSES, resume=False).close()
    (tmp_path / "own.npz").unlink()
    look = read_manifest(tmp_path / "s").config.calibrations.gel["SIM-D0001"]
    assert np.array_equal(look.weights, np.arange(27.0).reshape(9, 3))
    assert np.allclose(look.noise.colours, np.diag([4.0, 1.0, 9.0]), atol=1e-6)
    assert (look.shape, look.mm_per_px) == ((320, 240), (0.05, 0.06))
    assert [file.verdict for file in bench.calibrations.files.values()] == ["good"]
    assert not load_bench("fake").calibrations.gel


@pytest.mark.parametrize(("kind", "device"), [("gripper", "gripper"), ("tcp", "tool"), ("camera", "camera")])
def test_calibration_of_simulated_devices_is_refused_for_real_ones(
    tmp_path: Path, kind: str, device: str
) -> None:
    real = BenchConfig.model_validate({**load_bench("wire").model_dump(), "fakes": None})
    name = real.camera.serial if kind == "camera" else real.name
    keep(tmp_path, kind, {device: name}, {})
    with pytest.raises(CalibrationError, match="made on simulated devices"):
        find_calibrations(real, tmp_path)


def test_calibration_of_a_simulated_or_another_sensor_is_refused_for_a_real_one(tmp_path: Path) -> None:
    keep(tmp_path, "tactile", {"tactile": "SIM-D0001"}, {"pixel_aspect": 1.0})
    real = BenchConfig.model_validate({**load_bench("wire").model_dump(), "fakes": None})
    with pytest.raises(CalibrationError, match="made on simulated devices"):
        find_calibrations(real, tmp_path)
    for simulated, serial, said in (
        (True, "D20641", "was made on simulated devices"),
        (False, "D20642", "belongs to tactile D20641, the bench has D20642"),
    ):
        bench = with_gel(tmp_path, "bench.toml", simulated)
        tip = DigitConfig(driver="digit", serial=serial, gel=bench.tactile[0].gel)
        mixed = bench.model_copy(update={"tactile": (tip, bench.tactile[1])})
        with pytest.raises(CalibrationError, match=said):
            find_calibrations(mixed, tmp_path / "nothing")
