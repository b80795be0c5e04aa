"""Benches that lack parts: one sensor on a desk, and real sensors beside a simulated arm."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import OperatorStopError
from protocols.grasps import find_grasp_file
from rig.bench.operators import ConsoleOperator
from rig.bench.source import session_bench
from rig.calibrate.bench import Station
from rig.calibrate.camera import CameraOptions, collect_camera
from rig.calibrate.clocks import SyncOptions, collect_streams, solve_pair, solve_streams
from rig.calibrate.kind import Samples
from rig.config import BENCHES, load_bench
from rig.experiments.record import RecordSettings, run_record
from rig.sessions.manifest import read_manifest
from rig.sessions.rows import read_poses
from support.command_line import answer, refusal, rig
from support.own_devices import MODULE, SOURCE
from support.own_estimators import forget

DESK = 'name = "desk"\n[[tactile]]\ndriver = "fake"\nserial = "SIM-D0001"\n'
EYE = """
name = "eye"
[camera]
driver = "fake"
serial = "SIM-C0001"
rate_hz = 30
size_px = [640, 480]
focal_px = 640.0
marker_dictionary = "DICT_4X4_50"
marker_ids = [0, 1]
marker_side_m = 0.04
"""


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    (tmp_path / "desk.toml").write_text(DESK)
    return tmp_path / "desk.toml"


@pytest.fixture
def real_gel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A bench file with one real sensor, and the module of the sensor; `pressed` exists during a press."""
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "real.toml"
    file.write_text(DESK.replace('"fake"', f'"{MODULE}:Pressed"'))
    yield file
    sys.modules.pop(MODULE, None)
    forget()


def mixed_bench(folder: Path) -> Path:
    """Write the file of a simulated bench with two real sensors."""
    tip, text = '[[tactile]]\ndriver = "{}"', (BENCHES / "fake.toml").read_text()
    (folder / "mixed.toml").write_text(text.replace(tip.format("fake"), tip.format(f"{MODULE}:Pressed")))
    return folder / "mixed.toml"


@pytest.mark.heavy
def test_one_simulated_sensor_is_recorded_by_hand_and_marked(desk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    command = ["record", "--object", "7", "--by", "hand", "--bench", desk, "--out", folder, "--json"]
    shown = rig(*command, "--poses", 2, "--images", 5)
    figures = json.loads(shown.stdout)
    assert (figures["poses_accepted"], figures["images_accepted"]) == (2, 5)
    assert "SIMULATED 5 images in 2 poses" in shown.stderr
    manifest = read_manifest(folder)
    assert (manifest.by, manifest.simulated, manifest.serials) == ("hand", True, ("SIM-D0001",))
    images = [image for row in read_poses(folder) for image in row.images]
    assert {image.grip_counts for image in images} == {None}
    assert all(image.contact_area_px > 0 and (folder / image.file).is_file() for image in images)
    assert (folder / "reference" / "SIM-D0001.png").is_file()
    assert len(list((folder / "truth" / "masks").iterdir())) == 5
    assert "pressed by hand" in Path(figures["report"]).read_text()
    again = answer("record", "--resume", "--bench", desk, "--out", folder)
    assert again["images_accepted"] == 5
    exported = answer("export", folder, "--to", "csv", "--out", tmp_path / "csv")
    assert exported["counts"]["images"] == 5


@pytest.mark.heavy
def test_whole_simulated_bench_is_recorded_by_hand_with_its_fingertips_alone(tmp_path: Path) -> None:
    shown = rig(
        "record", "--object", "mug", "--by", "hand", "--poses", 1, "--images", 4, "--no-report", "--out",
        tmp_path / "s", "--json",
    )  # fmt: skip
    assert json.loads(shown.stdout)["images_accepted"] == 4
    serials = [image.serial for row in read_poses(tmp_path / "s") for image in row.images]
    assert serials == ["SIM-D0001"] * 2 + ["SIM-D0002"] * 2
    manifest = read_manifest(tmp_path / "s")
    assert not any(manifest.config.has(section) for section in ("arm", "gripper", "camera"))
    wire = refusal("record", "--object", "7", "--by", "hand", "--bench", "wire", "--out", tmp_path / "t")
    assert "simulated over the wire protocols" in wire


def by_hand(file: Path, folder: Path, answers: list[str]) -> list[str]:
    """Record two poses at a real sensor; the person presses unless `answers` holds "no" for that question."""
    asked: list[str] = []

    def ask(question: str) -> bool:
        asked.append(question)
        pressed = file.with_name("pressed")
        pressed.touch() if "Is it pressed?" in question else pressed.unlink(missing_ok=True)
        return not answers or answers.pop(0) != "no"

    config = load_bench(str(file))
    settings = RecordSettings(config, 0, find_grasp_file("7"), 2, 6, by="hand")
    with session_bench(config, ConsoleOperator(ask, agreed=True), "Begin?") as benches:
        run_record(folder, settings, benches=benches)
    return asked


@pytest.mark.heavy
def test_person_is_asked_for_each_pose_of_a_real_sensor_even_with_yes(real_gel: Path, tmp_path: Path) -> None:
    assert by_hand(real_gel, tmp_path / "s", []) == [
        "Take everything off the gels. Does nothing touch them?",
        *(f"Press object 7 (spam) at 'left', turned by {turn} deg (counter-clockwise in the image), onto the "
          "gel of SIM-D0001 and hold it. Is it pressed?" for turn in (-30, -15)),
    ]  # fmt: skip
    rows = read_poses(tmp_path / "s")
    assert [(row.accepted, len(row.images), row.simulated) for row in rows] == [(True, 3, False)] * 2
    image = cv2.imread(str(tmp_path / "s" / rows[0].images[0].file))
    assert np.abs(image[160, 120].astype(int) - (120, 60, 180)).max() < 20
    assert not read_manifest(tmp_path / "s").simulated
    with pytest.raises(OperatorStopError):
        by_hand(real_gel, tmp_path / "stopped", ["yes", "yes", "no"])
    assert [row.accepted for row in read_poses(tmp_path / "stopped")] == [True]


@pytest.mark.heavy
def test_doctor_and_calibration_work_with_one_sensor(desk: Path, tmp_path: Path) -> None:
    common = ["--bench", desk, "--json"]
    shown = rig("doctor", *common, "--seconds", 0.5, "--disk", tmp_path)
    findings = json.loads(shown.stdout)["findings"]
    parts = next(finding for finding in findings if finding["check"] == "parts")
    assert parts["seen"] == "has no [arm], [gripper], two [[tactile]], [camera]"
    assert "rig record --by hand" in parts["todo"]
    assert {finding["device"] for finding in findings} == {
        "computer", "bench", "disk", "calibration", "SIM-D0001",
    }  # fmt: skip
    made = json.loads(rig("calibrate", "tactile", *common).stdout)
    assert len(made["calibrations"]) == 1
    found = json.loads(rig("doctor", *common, "--seconds", 0.5, "--disk", tmp_path).stdout)["findings"]
    of_file = next(finding for finding in found if finding["device"] == "calibration")
    assert of_file["verdict"] == "good"
    assert of_file["figures"]["age_days"] < 0.1


@pytest.mark.heavy
def test_camera_alone_is_calibrated_with_a_board_held_by_hand(tmp_path: Path) -> None:
    file = tmp_path / "eye.toml"
    file.write_text(EYE)
    # the simulated person holds the board, and is asked nothing
    person = ConsoleOperator(lambda question: pytest.fail(question))
    at = Station(load_bench(str(file)), 0, tmp_path / "c", person, lambda text: None)
    (result,) = collect_camera(at, CameraOptions(poses=8))
    assert result.simulated
    assert len(list((tmp_path / "c" / "camera-samples").glob("*.png"))) == 8
    assert result.value["camera_matrix"]["data"][0] == pytest.approx(640.0, abs=5.0)


@pytest.mark.heavy
def test_fingertip_is_put_on_the_clock_of_the_camera_by_hand(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("protocols.capture_touch.BY_HAND_S", 6.0)
    desk.write_text(DESK + EYE.split("\n", 2)[2])
    config = load_bench(str(desk))
    at = Station(config, 0, tmp_path / "c", ConsoleOperator(lambda question: True), lambda text: None)
    (result,) = collect_streams(at, SyncOptions())
    assert result.serials == {"reference": "SIM-C0001", "stream": "SIM-D0001"}
    assert result.simulated
    assert result.value["add_to_stream_s"] == pytest.approx(0.0, abs=0.003)
    samples = tmp_path / "c" / "sync-samples"
    (again,) = solve_streams(Samples(samples), SyncOptions())
    assert again.value == result.value
    header, *rows = (samples / "SIM-D0001.csv").read_text().splitlines()
    late = [f"{int(time_ns) + 40_000_000},{value}" for time_ns, value in (row.split(",") for row in rows)]
    (samples / "LATE.csv").write_text("\n".join([header, *late, ""]))
    moved = solve_pair(samples, "SIM-C0001", "LATE")
    assert moved.value["add_to_stream_s"] == pytest.approx(-0.04, abs=0.003)


@pytest.mark.heavy
def test_real_sensor_beside_a_simulated_bench_is_not_marked(real_gel: Path, tmp_path: Path) -> None:
    file = mixed_bench(tmp_path)
    made = rig("calibrate", "tactile", "--bench", file, "--out", tmp_path / "c", "--json")
    assert "SIMULATED" not in made.stderr
    assert len(json.loads(made.stdout)["calibrations"]) == 2
    shown = rig("doctor", "--bench", file, "--seconds", 0.5, "--disk", tmp_path, "--json")
    findings = json.loads(shown.stdout)["findings"]
    kinds = next(finding for finding in findings if finding["check"] == "kinds")
    assert kinds["seen"] == "simulated: arm, gripper, SIM-C0001; real: SIM-D0001, SIM-D0002"
    assert {"arm", "gripper", "SIM-C0001", "SIM-D0001"} <= {finding["device"] for finding in findings}
