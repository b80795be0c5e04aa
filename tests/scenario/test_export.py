"""Exports, opened by the libraries of the tools they are for."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.errors import InputError, SessionError
from protocols.grasps import find_grasp_file
from protocols.observer import Phase
from rig.cli.main import app
from rig.config import load_bench
from rig.experiments.pose_attempt import RecordSettings
from rig.experiments.record import run_record
from rig.export.formats import export_session
from rig.sessions.layout import TRUE_MASKS
from rig.sessions.reading import recorded_angles, recorded_frames
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC
from rig.sessions.rows import read_finished_lifts, read_poses
from rig.sessions.table_files import read_csv


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "record"
    run_record(folder, RecordSettings(load_bench("fake"), 0, find_grasp_file("7"), poses=1, images=4))
    shutil.rmtree(folder / "truth", ignore_errors=True)
    return folder


def test_csv_and_parquet_hold_the_same_tables(one_lift: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    export_session(one_lift, "csv", tmp_path / "csv")
    export_session(one_lift, "parquet", tmp_path / "parquet")
    names = {"lifts", "angles", "arm", "gripper", "frames"}
    assert {path.stem for path in (tmp_path / "csv").iterdir()} == names
    for name in names:
        table = parquet.read_table(tmp_path / "parquet" / f"{name}.parquet")
        kinds = {"string": str, "int64": int, "double": float, "bool": bool}
        columns = {column.name: kinds[str(column.type)] for column in table.schema}
        assert read_csv(tmp_path / "csv" / f"{name}.csv", columns) == table.to_pylist()
        units = {column.name: (column.metadata or {}).get(b"unit", b"").decode() for column in table.schema}
        for column, unit in (("t_lift_s", "s"), ("angle_deg", "deg"), ("force_x_n", "N"), ("x_m", "m")):
            assert units.get(column, unit) == unit
        assert table.schema.metadata[b"simulated"] == b"SIMULATED"
        assert table.schema.metadata[b"session"].decode() == one_lift.name
        assert set(table["session"].to_pylist()) == {one_lift.name}
    row = read_finished_lifts(one_lift)[0]
    lift = parquet.read_table(tmp_path / "parquet/lifts.parquet").to_pylist()[0]
    assert (lift["re_mean_deg"], lift["object"]) == (row.re.mean_deg if row.re else None, "t2")
    angles = parquet.read_table(tmp_path / "parquet/angles.parquet").to_pylist()
    for source, topic in (("fused", FUSED_TOPIC), ("markers", TRUTH_TOPIC)):
        stored = recorded_angles(one_lift / "lifts/001.mcap", topic)[topic]
        lines = [line for line in angles if line["source"] == source]
        assert [line["angle_deg"] for line in lines] == [value.angle_deg for value in stored]
        assert {line["phase"] for line in lines} <= {"A", "B", "C", "lower"}
    in_b = [line["t_lift_s"] for line in angles if line["phase"] == "B"]
    assert 0.0 <= min(in_b) < max(in_b) <= row.phases_s[Phase.HOLD] - row.phases_s[Phase.LIFT]
    frames = parquet.read_table(tmp_path / "parquet/frames.parquet").to_pylist()
    assert len(frames) == sum(row.frames.values())


@pytest.mark.filterwarnings("ignore:__array__ implementation")  # pycocotools 2.0.11 with numpy 2
def test_coco_is_read_by_pycocotools_and_says_where_its_masks_come_from(
    one_lift: Path, recording: Path, tmp_path: Path
) -> None:
    coco_module = pytest.importorskip("pycocotools.coco")
    for session, least in ((one_lift, 20), (recording, 4)):
        out = tmp_path / session.name
        exported = export_session(session, "coco", out)
        coco = coco_module.COCO(str(out / "annotations.json"))
        assert len(coco.getImgIds()) == exported.counts["images"] >= least
        assert "SIMULATED" in coco.dataset["info"]["description"]
        assert "proposed by plain image processing" in coco.dataset["info"]["description"]
        for annotation in coco.loadAnns(coco.getAnnIds()):
            image = coco.loadImgs(annotation["image_id"])[0]
            picture = cv2.imread(str(out / "images" / image["file_name"]))
            assert picture is not None
            mask = coco.annToMask(annotation)
            assert mask.shape == picture.shape[:2] == (image["height"], image["width"])
            assert mask.sum() == pytest.approx(annotation["area"], rel=0.03)


def test_stored_true_masks_are_exported(recording: Path, tmp_path: Path) -> None:
    session = tmp_path / "session"
    shutil.copytree(recording, session)
    first = read_poses(session)[0].images[0].file
    truth = np.zeros((320, 240), np.uint8)
    truth[100:200, 50:150] = 255
    (session / TRUE_MASKS).mkdir(parents=True)
    cv2.imwrite(str(session / TRUE_MASKS / f"{Path(first).stem}.png"), truth)
    exported = export_session(session, "labelme", tmp_path / "out")
    assert any("true contact" in note and note.startswith("SIMULATED 1 image") for note in exported.notes)
    document = json.loads((tmp_path / "out" / Path(first).with_suffix(".json")).read_text())
    corners = np.array(document["shapes"][0]["points"])
    assert corners.min(axis=0) == pytest.approx([50, 100], abs=0.5)
    assert corners.max(axis=0) == pytest.approx([150, 200], abs=0.5)
    cv2.imwrite(str(session / TRUE_MASKS / f"{Path(first).stem}.png"), truth[:10])
    with pytest.raises(SessionError, match="true mask"):
        export_session(session, "coco", tmp_path / "other")


def labelme_files(session: Path, out: Path) -> list[Path]:
    export_session(session, "labelme", out)
    return sorted(out.rglob("*.json"))


def test_labelme_files_lie_beside_their_images_with_the_fields_its_loader_asks_for(
    recording: Path, tmp_path: Path
) -> None:
    files = labelme_files(recording, tmp_path / "out")
    assert len(files) == 4
    for file in files:
        document = json.loads(file.read_text())
        picture = cv2.imread(str(file.parent / document["imagePath"]))
        assert picture is not None
        assert picture.shape[:2] == (document["imageHeight"], document["imageWidth"])
        assert (file.parent / document["imagePath"]).read_bytes() == (
            recording / "07_spam/image_label" / document["imagePath"]
        ).read_bytes()
        # labelme/_label_file.py: label and shape_type are texts, points pairs of numbers, flags a mapping
        for shape in document["shapes"]:
            assert (shape["label"], shape["shape_type"], shape["flags"]) == ("contact", "polygon", {})
            assert len(shape["points"]) >= 3
            assert all(isinstance(v, float) for point in shape["points"] for v in point)


def test_labelmes_own_loader_reads_its_files(recording: Path, tmp_path: Path) -> None:
    labelme = pytest.importorskip("labelme", reason="labelme (a Qt program) is not installed")
    for file in labelme_files(recording, tmp_path / "out"):
        loaded = labelme.LabelFile(str(file))
        assert loaded.imageData
        assert loaded.shapes[0]["label"] == "contact"


def test_a_lerobot_data_set_has_its_parts_and_the_stored_images(one_lift: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    export_session(one_lift, "lerobot", out)
    info = json.loads((out / "meta/info.json").read_text())
    data = parquet.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 30, 1)
    assert set(data.column_names) == set(info["features"])
    assert len(data) == info["total_frames"] > 100
    np.testing.assert_allclose(np.diff(data["timestamp"].to_numpy()), 1 / 30, atol=1e-5)
    assert data["observation.state"][0].as_py() == pytest.approx(data["action"][0].as_py(), abs=0.05)
    assert data["observation.state"][1].as_py() == data["action"][0].as_py()
    stored = {frame.jpeg for frame in recorded_frames(one_lift / "lifts/001.mcap", "SIM-D0001")}
    kept = [image["bytes"] for image in data["observation.images.finger_b"].to_pylist()]
    assert set(kept) <= stored
    assert len(set(kept)) == len(kept)
    row = read_finished_lifts(one_lift)[0]
    assert data["angle.truth_deg"][-1].as_py() == pytest.approx(row.final_truth_deg, abs=1.0)
    episode = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()[0]
    assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (0, len(data))
    stats = json.loads((out / "meta/stats.json").read_text())
    state = np.array(data["observation.state"].to_pylist())
    np.testing.assert_allclose(stats["observation.state"]["mean"], state.mean(axis=0), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(stats["observation.state"]["std"], state.std(axis=0), rtol=1e-3, atol=1e-6)
    assert np.array(stats["observation.images.camera"]["mean"]).shape == (3, 1, 1)
    card = (out / "README.md").read_text()
    assert "SIMULATED" in card
    assert "`finger_b` SIM-D0001 (sign +1), `finger_c` SIM-D0002 (sign -1), `camera` SIM-C0001" in card
    assert not any("SIM-D" in name for name in info["features"])


def test_lerobots_own_loader_reads_the_data_set(one_lift: Path, tmp_path: Path) -> None:
    module: Any = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="lerobot (with torch) is not installed"
    )
    export_session(one_lift, "lerobot", tmp_path / "out")
    data = module.LeRobotDataset("rig/lifts", root=tmp_path / "out")
    assert data.num_episodes == 1
    assert tuple(data[0]["observation.images.camera"].shape) == (3, 480, 640)


def test_an_export_is_whole_or_not_there(one_lift: Path, recording: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(one_lift, broken)
    file = broken / "lifts/001.mcap"
    file.write_bytes(file.read_bytes()[:200_000])
    for to in ("csv", "coco"):
        with pytest.raises(SessionError, match=r"001\.mcap"):
            export_session(broken, to, tmp_path / "out")
    with pytest.raises(InputError, match="no episodes"):
        export_session(recording, "lerobot", tmp_path / "out")
    with pytest.raises(InputError, match="choose one of csv"):
        export_session(one_lift, "excel", tmp_path / "out")
    with pytest.raises(InputError, match="no such session"):
        export_session(tmp_path / "nothing", "csv", tmp_path / "out")
    assert {path.name for path in tmp_path.iterdir()} == {"broken"}
    with pytest.raises(InputError, match="exists already"):
        export_session(one_lift, "csv", tmp_path / "broken")


def test_command_prints_counts_and_folder(one_lift: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        app, ["export", str(one_lift), "--to", "csv", "--out", str(tmp_path / "x"), "--json"]
    )
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert figures["counts"]["lifts"] == 1
    assert Path(figures["out"]) == tmp_path / "x"
    assert "SIMULATED" in done.stderr
