"""`rig calibrate`: from folders to files and pages, and its error messages."""

import csv
import json
import re
import subprocess
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.store import CalibrationFile, load, read_yaml
from calibration.verdict import Verdict
from drivers.clock import to_ns
from drivers.images import read_image
from drivers.types import Frame, Pose
from fakes.devices.camera import unit_seed
from fakes.gel.sensor import GelSensor
from fakes.world.fixture import tip_m
from fakes.world.kinematics import TOOL_LENGTH_M
from rig.calibrate.clocks import WiggleObserver
from rig.calibrate.kinds import KINDS
from rig.calibrate.samples import pose_row
from rig.config import load_bench
from rig.config.write import write_bench
from support.benches import lighter
from support.command_line import rig
from support.marker_pictures import MarkerPictures
from support.motions import general_scene, pivot_scene, wiggle_scene
from support.simulated_gel import SimulatedGel

pytestmark = pytest.mark.usefixtures("quick_figures")


def calibrate(*arguments: object) -> "subprocess.CompletedProcess[str]":
    return rig("calibrate", *arguments)


def figures(*arguments: object) -> dict:
    done = calibrate(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout)
    return results["calibrations"][0] if len(results.get("calibrations", ())) == 1 else results


def page_is_whole(page: str, pictures: int) -> None:
    """One file that needs nothing else, with its figures in it."""
    text = Path(page).read_text()
    assert text.count("data:image/png;base64,") + text.count('<svg role="img"') >= pictures
    assert "var(--" in text.partition("</style>")[2]  # charts in the page's colours, light and dark
    assert "http://" not in text.replace("http://www.w3.org", "")
    own = ['<script type="application/json">', "<script>"] if 'class="poses"' in text else []
    assert re.findall(r"<script[^>]*>", text) == own
    assert "nan" not in text.lower().replace("data:image", "").split("base64")[0]


def check_camera(made: Sequence[CalibrationFile], _: Path) -> None:
    assert str(made[0].assessment) == "good"  # with the poses that it chose by itself
    focal_px = made[0].value["camera_matrix"]["data"][0]
    assert focal_px == pytest.approx(640.0, abs=min(4.0, 4 * made[0].quality["sigma"][0]))
    assert made[0].value["image_width"] == 640


def check_hand_eye(made: Sequence[CalibrationFile], _: Path) -> None:
    assert np.linalg.norm(np.subtract(made[0].value["translation_m"], (0.45, -0.62, 0.16))) < 2e-3


def check_markers(made: Sequence[CalibrationFile], _: Path) -> None:
    assert made[0].inputs["used"] == 60
    assert made[0].value["angle_sigma_deg"] < 0.05


def check_tactile(made: Sequence[CalibrationFile], folder: Path) -> None:
    placed = []
    for each in made:
        truth = GelSensor(unit_seed(each.serials["tactile"])).mm_per_px
        assert each.value["pixel_aspect"] == pytest.approx(truth[0] / truth[1], abs=0.015)
        # one ball size does not determine the gel's bulge: its scale is up to a tenth too large
        assert 1.0 < each.value["mm_per_px"][0] / truth[0] < 1.12
        samples = folder / f"tactile-{each.serials['tactile']}-samples"
        rows = list(csv.DictReader((samples / "catalog.csv").read_text().splitlines()))
        assert [float(row["diameter(mm)"]) for row in rows] == [12.0] * 9
        for row in rows:
            pressed, untouched = (read_image(samples / row[key]) for key in ("image", "background"))
            assert np.abs(np.subtract(pressed, untouched, dtype=int)).max() > 40
        placed.append([(float(row["x_mm"]), float(row["y_mm"])) for row in rows])
    assert placed[0] == [(-x, y) for x, y in placed[1]]


def check_gripper(made: Sequence[CalibrationFile], _: Path) -> None:
    limits, table = load_bench("fake").require("gripper").limits, made[0].value["closing"]
    nominal = limits.max_opening_m - (np.asarray(table["counts"]) - 6) * limits.opening_per_count_m
    assert np.abs(np.asarray(table["opening_m"]) - nominal).max() < 1.2 * limits.opening_per_count_m
    assert made[0].quality["hysteresis_m"] < 2.0 * limits.opening_per_count_m


def check_tcp(made: Sequence[CalibrationFile], _: Path) -> None:
    value, sigma = made[0].value, np.asarray(made[0].quality["translation_m_sigma"])
    off = np.abs(np.subtract(value["translation_m"], np.add((0.0, 0.0, TOOL_LENGTH_M), tip_m(0))))
    assert (off < 4 * sigma + 5e-5).all()
    assert sigma.max() < 5e-4
    assert value["bench_file_tcp_m"] == pytest.approx([0.0, 0.0, TOOL_LENGTH_M])
    assert value["tip_from_tcp_m"] == pytest.approx(list(tip_m(0)), abs=1e-3)


CAMERA_LATE_S = 0.020
"""Delay of the camera's frames while the clocks are compared."""


def check_sync(made: Sequence[CalibrationFile], _: Path) -> None:
    assert [each.serials["stream"] for each in made] == ["SIM-C0001", "SIM-D0001", "SIM-D0002"]
    for each in made:
        truth = -CAMERA_LATE_S if each.serials["stream"] == "SIM-C0001" else 0.0
        assert each.assessment.verdict is Verdict.GOOD, each.assessment
        assert each.value["add_to_stream_s"] == pytest.approx(truth, abs=1e-3)


CAMERA = """\
image_width: 640
image_height: 480
distortion_model: plumb_bob
distortion_coefficients: {data: [0, 0, 0, 0, 0]}
camera_matrix: {data: [640, 0, 319.5, 0, 640, 239.5, 0, 0, 1]}
"""
ON_BENCH = (
    ("camera", check_camera, "--bench fake", "--serial C1", 6),
    ("hand-eye", check_hand_eye, "--bench fake --poses 8", "--camera camera.yaml", 3),
    ("markers", check_markers, "--bench fake", "--camera camera.yaml", 1),
    ("tactile", check_tactile, "--bench light.toml --ball-mm 12 --presses 9", "", 3),
    ("gripper", check_gripper, "--bench light.toml --block-mm 20 --block-mm 45 --block-mm 70", "", 1),
    ("tcp", check_tcp, "--bench fake --poses 10", "--bench fake", 2),
    ("sync", check_sync, "--bench light.toml", "", 1),
)
"""Kinds with a check of their files, options on the bench and with its samples, and pictures of a page."""


def test_every_kind_is_calibrated_again_from_its_own_samples() -> None:
    assert {name for name, *_ in ON_BENCH} == set(KINDS)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "check", "on_bench", "of_samples", "pictures"), ON_BENCH, ids=[each[0] for each in ON_BENCH]
)
def test_bench_is_calibrated_and_its_samples_give_the_same_file_again(
    kind: str, check: Callable[[Sequence[CalibrationFile], Path], None], on_bench: str, of_samples: str,
    pictures: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    observe = WiggleObserver.frame

    def delay_camera(self: WiggleObserver, frame: Frame) -> None:
        late_ns = to_ns(CAMERA_LATE_S) if frame.serial == "SIM-C0001" else 0
        observe(self, replace(frame, time_ns=frame.time_ns + late_ns))

    monkeypatch.setattr(WiggleObserver, "frame", delay_camera)
    write_bench(Path("light.toml"), lighter())
    Path("camera.yaml").write_text(CAMERA)
    done = json.loads(calibrate(kind, *on_bench.split(), "--out", "done", "--json").stdout)["calibrations"]
    check([load(Path(each["file"]), kind) for each in done], Path("done"))
    samples = min(Path("done").glob("*-samples"))
    solved = calibrate(kind, "--from", samples, *of_samples.split(), "--out", "again", "--json")
    again, *others = json.loads(solved.stdout)["calibrations"]
    assert len(others) == (2 if kind == "sync" else 0)
    for each in (*done, again):
        assert each["simulated"], "samples keep the mark of their bench"
        page_is_whole(each["page"], pictures)
    assert again["numbers"] == done[0]["numbers"]
    files = [Path(each["file"]) for each in (done[0], again)]
    inputs = [load(file, kind).inputs for file in files]
    if kind == "camera":
        assert load(files[1], kind).serials == {"camera": "C1"}
    assert inputs[0]["sha256"] == inputs[1]["sha256"] != sha256().hexdigest()
    compared = calibrate("compare", *files, "--json")
    if kind in ("markers", "tactile"):
        assert "open their pages instead" in compared.stderr
    else:
        assert max(v for v in json.loads(compared.stdout).values() if isinstance(v, float)) < 0.01


def test_refused_camera_calibration_writes_a_page_and_exits_with_2(tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for name in ("00.png", "01.png"):
        cv2.imwrite(str(few / name), np.full((120, 160), 90, np.uint8))
    done = calibrate("camera", "--from", few, "--target", "chessboard:9x6:25", "--out", tmp_path)
    assert done.returncode == 2
    assert "0 usable distinct views" in done.stderr
    assert "left out 2 (00.png, 01.png)" in done.stderr
    assert "refused" in (tmp_path / "camera-unknown.html").read_text()
    assert read_yaml(tmp_path / "camera-unknown.yaml")["calibration"]["verdict"] == "refused"


def write_pairs(folder: Path, rows: Mapping[str, Sequence[str]]) -> None:
    for name, lines in rows.items():
        (folder / name).write_text("\n".join(["id,x_m,y_m,z_m,qx,qy,qz,qw", *lines]) + "\n")


def test_hand_eye_from_target_poses_needs_no_camera(tmp_path: Path) -> None:
    truth, samples = general_scene(np.random.default_rng(2), 15)
    seen = [pose_row(s.id, truth.x.inverse() @ s.base_T_tcp @ truth.z) for s in samples]
    seen[3] = seen[3].replace(samples[3].id, "99", 1)
    poses = [pose_row(s.id, s.base_T_tcp) for s in samples]
    write_pairs(tmp_path, {"poses.csv": poses, "targets.csv": seen})
    done = figures("hand-eye", "--from", tmp_path, "--out", tmp_path / "out")
    assert np.linalg.norm(np.subtract(done["value"]["translation_m"], truth.x.position_m)) < 1e-3
    assert {r["id"] for r in done["rejected"]} == {samples[3].id, "99"}
    assert done["quality"]["noise_robot_m"] < 1e-3


@pytest.mark.heavy
def test_fingertip_references_are_compared_with_the_previous_ones(tmp_path: Path) -> None:
    first = figures("tactile", "--bench", "fake", "--out", tmp_path)["calibrations"]
    assert [r["verdict"] for r in first] == ["weak", "weak"]
    again = figures("tactile", "--bench", "fake", "--seed", "1", "--out", tmp_path)["calibrations"]
    assert [r["verdict"] for r in again] == ["good", "good"]
    serials = ("SIM-D0001", "SIM-D0002")
    pictures = [tmp_path / f"tactile-reference-{serial}.png" for serial in serials]
    pictures[0].write_bytes(pictures[1].read_bytes())
    swapped = calibrate("tactile", "--bench", "fake", "--out", tmp_path)
    assert swapped.returncode == 2
    assert "changed shape" in swapped.stderr


@pytest.mark.heavy
def test_gel_is_calibrated_from_presses(tmp_path: Path) -> None:
    gel = SimulatedGel(3)
    background = np.rint(gel.reference).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "background.png"), background[..., ::-1])
    rows = ["image,diameter(mm)"]
    for press in gel.presses(12):
        cv2.imwrite(str(tmp_path / f"{press.name}.png"), press.image[..., ::-1])
        rows.append(f"{press.name}.png,{2 * press.radius_mm}")
    (tmp_path / "catalog.csv").write_text("\n".join(rows))
    done = figures("tactile", "--from", tmp_path, "--serial", "D1", "--out", tmp_path / "out")
    assert done["used"] == 12
    assert load(Path(done["file"]), "tactile").serials == {"tactile": "D1"}
    page_is_whole(done["page"], 3)


@pytest.mark.heavy
def test_opening_and_clocks_are_calibrated_from_files(tmp_path: Path) -> None:
    rows = [f"{c},{120 - 0.5 * c},{way}" for way in ("closing", "opening") for c in range(10, 200, 20)]
    (tmp_path / "gripper.csv").write_text("\n".join(["counts,opening_mm,direction", *rows]))
    assert figures("gripper", "--from", tmp_path, "--out", tmp_path / "out")["verdict"] == "good"
    (tmp_path / "wiggle").mkdir()
    write_wiggle(tmp_path / "wiggle", ("robot", "camera"))
    offset = figures("sync", "--from", tmp_path / "wiggle", "--out", tmp_path / "out")
    assert offset["value"]["add_to_stream_s"] == pytest.approx(0.0473, abs=1.5e-3)


def write_wiggle(folder: Path, names: tuple[str, str]) -> None:
    for name, stream in zip(names, wiggle_scene(np.random.default_rng(0)), strict=True):
        text = [f"{t},{v:.6f}" for t, v in zip(stream.time_ns, stream.values, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["time_ns,value", *text]))


@pytest.mark.parametrize("reference", ["arm", "SIM-C0001"])
def test_streams_that_the_rig_stored_are_calibrated_without_their_names(
    reference: str, tmp_path: Path
) -> None:
    write_wiggle(tmp_path, (reference, "SIM-D0001"))
    if reference != "arm":
        refused = calibrate("sync", "--from", tmp_path)
        assert refused.returncode == 2
        assert "this folder has SIM-C0001.csv, SIM-D0001.csv; give --reference and" in refused.stderr
        (tmp_path / "reference.txt").write_text(f"{reference}\n")
    found = figures("sync", "--from", tmp_path, "--out", tmp_path / "out")
    assert (found["value"]["reference"], found["value"]["stream"]) == (reference, "SIM-D0001")
    assert found["value"]["add_to_stream_s"] == pytest.approx(0.0473, abs=1.5e-3)
    missing = calibrate("sync", "--from", tmp_path, "--stream", "camera")
    assert f"there is no {tmp_path}/camera.csv: this folder has" in missing.stderr


def write_tip_poses(folder: Path, poses: Sequence[tuple[str, Pose]], child_frame: str) -> None:
    """Write poses.csv of a pivoted tip; without the column child_frame if that is empty."""
    named = f",{child_frame}" if child_frame else ""
    header = "id,x_m,y_m,z_m,qx,qy,qz,qw" + (",child_frame" if child_frame else "")
    rows = [pose_row(name, pose) + named for name, pose in poses]
    (folder / "poses.csv").write_text("\n".join([header, *rows]))


def test_tip_poses_need_a_stated_frame_and_a_far_tip_must_be_accepted(tmp_path: Path) -> None:
    tip, poses = pivot_scene(np.random.default_rng(0), 12)  # 0.283 m beyond tcp_m
    command = ("tcp", "--from", tmp_path, "--out", tmp_path / "out")
    for frame, options, said in (
        ("", ("--bench", "fake"), "add a column child_frame"),
        ("tcp", (), "give --bench"),
        ("tcp", ("--bench", "fake", "--yes"), "the tip is 283 mm from the bench file's tcp_m"),
    ):
        write_tip_poses(tmp_path, poses, frame)
        done = calibrate(*command, *options)
        assert done.returncode == 2
        assert said in done.stderr
    found = figures(*command, "--bench", "fake", "--accept-change")
    value, expected = found["value"], np.add(tip, (0.0, 0.0, 0.28))
    assert found["verdict"] == "weak"
    assert value["translation_m"] == pytest.approx(expected.tolist(), abs=1e-3)
    assert value["bench_file_tcp_m"] == [0.0, 0.0, 0.28]
    assert value["tip_from_tcp_m"] == pytest.approx(tip.tolist(), abs=1e-3)
    page = Path(found["page"]).read_text().replace("\N{MINUS SIGN}", "-")
    for text in (*found["numbers"].values(), "tcp_m of the bench file"):
        assert text in page
    write_tip_poses(tmp_path, poses, "flange")
    value = figures(*command)["value"]
    assert value["translation_m"] == pytest.approx(tip.tolist(), abs=1e-3)
    assert "bench_file_tcp_m" not in value


@pytest.mark.heavy
def test_board_is_drawn_to_scale(tmp_path: Path) -> None:
    svg, pdf = tmp_path / "board.svg", tmp_path / "board.pdf"
    for path in (svg, pdf):
        assert calibrate("board", "charuco:8x6:25:18:DICT_5X5_100", "--out", path).returncode == 0
    text = svg.read_text()
    assert 'width="224.000mm"' in text
    assert 'width="100.0000"' in text
    ticks = [float(x) for x in re.findall(r'<rect x="([0-9.]+)" y="[0-9.]+" width="0.2000"', text)]
    assert ticks == pytest.approx([11.9 + 10.0 * i for i in range(11)])
    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ([0-9.]+) \]", pdf.read_bytes())
    assert box is not None
    points_per_mm = 72.0 / 25.4
    assert [float(side) / points_per_mm for side in box.groups()] == pytest.approx([224.0, 196.0], abs=0.01)


def test_protractor_has_lines_through_its_middle_every_5_degrees(tmp_path: Path) -> None:
    svg, pdf = tmp_path / "sheet.svg", tmp_path / "sheet.pdf"
    for path in (svg, pdf):
        assert calibrate("board", "protractor", "--out", path).returncode == 0
    ends = r'x1="([0-9.]+)" y1="([0-9.]+)" x2="([0-9.]+)" y2="([0-9.]+)"'
    in_svg = np.array(re.findall(ends, svg.read_text()), float).reshape(-1, 2, 2) * (1, -1)
    streams = re.findall(rb"\nstream\r?\n(.*?)endstream", pdf.read_bytes(), re.DOTALL)
    drawing = b"\n".join(zlib.decompressobj().decompress(each) for each in streams)
    stroke = rb"([0-9.]+) ([0-9.]+) m\n([0-9.]+) ([0-9.]+) l\n+S\n"
    in_pdf = np.array(re.findall(stroke, drawing), float).reshape(-1, 2, 2) / 72.0 * 25.4
    for lines in (in_svg, in_pdf):
        along = lines[:, 1] - lines[:, 0]
        angles = np.degrees(np.arctan2(along[:, 1], along[:, 0]))
        assert np.sort(angles) == pytest.approx(np.arange(-175.0, 181.0, 5.0), abs=0.01)
        middle = lines.mean(axis=(0, 1))
        across = along / np.linalg.norm(along, axis=1, keepdims=True) @ [[0.0, 1.0], [-1.0, 0.0]]
        assert np.abs(((lines[:, 0] - middle) * across).sum(axis=1)).max() < 0.01
        assert np.linalg.norm(along, axis=1) == pytest.approx(50.0, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("gripper", "--block-mm", "200"), "between the fingers fit"),
        (("tactile", "--ball-mm", "0.5"), "diameters of 2 to 30 mm"),
        (("sync", "--object", "gauge:wide"), "as gauge:30"),
        (("board", "--out", "board.txt"), ".svg or .pdf"),
        (("camera", "--from", "/nowhere"), "no such folder"),
        (("hand-eye", "--from", "/nowhere"), "give --camera"),
        (("hand-eye", "--setup", "sideways"), "eye-to-hand"),
        (("gripper", "--from", "/nowhere"), "cannot be read"),
        (("board", "ring:4"), "not valid"),
        (("compare", "/nowhere", "/nowhere"), "cannot be read"),
    ],
)
def test_usage_errors_are_one_line_and_exit_with_2(arguments: tuple[str, ...], said: str) -> None:
    done = calibrate(*arguments)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("count", [4, 12])
def test_reasons_of_rejected_rows_are_counted_on_the_terminal(count: int, tmp_path: Path) -> None:
    """Each pose stands three times, three rows are damaged; with four poses the calibration is refused."""
    truth, samples = general_scene(np.random.default_rng(0), count)
    named = [(f"{i:03d}", sample.base_T_tcp) for i, sample in enumerate(samples * 3)]
    poses = [pose_row(name, pose) for name, pose in named]
    seen = [pose_row(name, truth.x.inverse() @ pose @ truth.z) for name, pose in named]
    poses += ["900,0,0,0,0,0,0,", "901,0,0,0,0,0,x,1", "001,0,0,0,0,0,0,1"]
    write_pairs(tmp_path, {"poses.csv": poses, "targets.csv": seen})
    done = calibrate("hand-eye", "--from", tmp_path, "--out", tmp_path)
    assert done.returncode == (2 if count == 4 else 0)
    lines = [line for line in done.stderr.splitlines() if line.startswith("left out")]
    assert f"left out {2 * count} ({count:03d}, {count + 1:03d}, {count + 2:03d} and" in "\n".join(lines)
    assert "left out 900: line" in done.stderr
    assert "column qz: 'x' is not a number" in done.stderr
    assert "the id 001 a second time" in done.stderr
    assert len(lines) <= 5


def test_uncertainty_of_a_turn_is_unknown_without_a_camera(tmp_path: Path) -> None:
    scene, rng = MarkerPictures(), np.random.default_rng(0)
    for number in range(20):
        cv2.imwrite(str(tmp_path / f"{number:02d}.png"), scene.draw(0.0, rng))
    done = calibrate("markers", "--from", tmp_path, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["calibrations"][0]
    assert found["verdict"] == "weak"
    for name in ("one sigma", "due to the camera"):
        assert found["numbers"][f"a turn of 30 degrees, {name}"] == "unknown without intrinsics (--camera)"
    assert not any("turn_sigma" in key for key in (*found["value"], *found["quality"]))
