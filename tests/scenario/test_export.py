"""Exports are opened with the libraries of the target tools."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2

from drivers.clock import NS_PER_S
from drivers.errors import InputError, SessionError
from drivers.types import Pose
from protocols.grasps import find_grasp_file
from protocols.observer import Phase
from rig.config import extras, load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.record import RecordSettings, run_record
from rig.experiments.trial import run_trial
from rig.export.formats import export_session
from rig.export.messages import ContinuousPoses
from rig.frames.series import read_frames
from rig.sessions.about import SIMULATED_EPOCH_NS
from rig.sessions.files import TRUE_MASKS
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import recorded_angles, recorded_arm_states, recorded_frames
from rig.sessions.rows import read_finished_lifts, read_poses
from rig.tactile.angles import FUSED, MARKERS
from rig.tactile.estimators import choose_estimator
from support.benches import lighter, short_phases
from support.recordings import written_again
from support.tables import read_typed_csv


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "record"
    run_record(folder, RecordSettings(load_bench("fake"), 0, find_grasp_file("7"), poses=1, images=4))
    shutil.rmtree(folder / "truth", ignore_errors=True)
    return folder


def changes_sign(quaternions_xyzw: Sequence[Sequence[float]]) -> bool:
    """Whether neighbours in a list have opposite signs although they are almost the same rotation."""
    quaternions = np.array(quaternions_xyzw)
    return bool((np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0).any())


@pytest.mark.heavy
def test_csv_and_parquet_contain_the_same_tables(one_lift: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    export_session(one_lift, "csv", tmp_path / "csv")
    export_session(one_lift, "parquet", tmp_path / "parquet")
    names = {"lifts", "angles", "arm", "gripper", "frames"}
    assert {path.stem for path in (tmp_path / "csv").iterdir()} == names
    for name in names:
        table = parquet.read_table(tmp_path / "parquet" / f"{name}.parquet")
        kinds = {"string": str, "int64": int, "double": float, "bool": bool}
        columns = {column.name: kinds[str(column.type)] for column in table.schema}
        assert read_typed_csv(tmp_path / "csv" / f"{name}.csv", columns) == table.to_pylist()
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
    for source, stored in recorded_angles(one_lift / "lifts/001.mcap", FUSED, MARKERS).items():
        lines = [line for line in angles if line["source"] == source]
        np.testing.assert_array_equal(
            np.array([line["angle_deg"] for line in lines], float), stored.angle_deg
        )
        assert {line["phase"] for line in lines} <= {"A", "B", "C", "lower"}
    in_b = [line["t_lift_s"] for line in angles if line["phase"] == "B"]
    assert 0.0 <= min(in_b) < max(in_b) <= row.phases_s[Phase.HOLD] - row.phases_s[Phase.LIFT]
    frames = parquet.read_table(tmp_path / "parquet/frames.parquet").to_pylist()
    assert len(frames) == sum(row.frames.values())
    arm = parquet.read_table(tmp_path / "parquet/arm.parquet").to_pylist()
    recorded = [
        state.base_T_tcp.quaternion_xyzw for state in recorded_arm_states(one_lift / "lifts/001.mcap")
    ]
    assert changes_sign(recorded), "the tool points down, and its pose has noise"
    assert not changes_sign([[row[name] for name in ("qx", "qy", "qz", "qw")] for row in arm])


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


@pytest.fixture(scope="module")
def labelme_files(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    out = tmp_path_factory.mktemp("labelme") / "out"
    export_session(recording, "labelme", out)
    return sorted(out.rglob("*.json"))


def test_labelme_files_are_beside_their_images_with_the_required_fields(
    recording: Path, labelme_files: list[Path]
) -> None:
    files = labelme_files
    assert len(files) == 4
    for file in files:
        document = json.loads(file.read_text())
        picture = cv2.imread(str(file.parent / document["imagePath"]))
        assert picture.shape[:2] == (document["imageHeight"], document["imageWidth"])
        assert (file.parent / document["imagePath"]).read_bytes() == (
            recording / "07_spam/image_label" / document["imagePath"]
        ).read_bytes()
        # labelme/_label_file.py: label and shape_type are texts, points pairs of numbers, flags a mapping
        for shape in document["shapes"]:
            assert (shape["label"], shape["shape_type"], shape["flags"]) == ("contact", "polygon", {})
            assert len(shape["points"]) >= 3
            assert all(isinstance(v, float) for point in shape["points"] for v in point)


def test_labelme_loader_reads_exported_files(labelme_files: list[Path]) -> None:
    labelme = pytest.importorskip("labelme", reason="labelme (a Qt program) is not installed")
    for file in labelme_files:
        loaded = labelme.LabelFile(str(file))
        assert loaded.imageData
        assert loaded.shapes[0]["label"] == "contact"


@pytest.fixture(scope="module")
def quick_tips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one lift whose fingertips deliver twice as many frames as the camera."""
    bench = lighter(tip_hz=30.0)
    bench = bench.model_copy(update={"camera": bench.camera.model_copy(update={"rate_hz": 15.0})})
    folder = tmp_path_factory.mktemp("lerobot") / "trial"
    with short_phases():
        run_trial(folder, TrialSettings(bench, 0, choose_estimator("pca")), ["t2"], lifts=1)
    return folder


@pytest.fixture(scope="module")
def lerobot(quick_tips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pyarrow.parquet")
    out = tmp_path_factory.mktemp("lerobot") / "out"
    export_session(quick_tips, "lerobot", out)
    return out


@pytest.mark.heavy
def test_lerobot_data_set_has_its_parts_and_the_stored_images(quick_tips: Path, lerobot: Path) -> None:
    from pyarrow import parquet

    out = lerobot
    info = json.loads((out / "meta/info.json").read_text())
    data = parquet.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 15, 1)
    assert set(data.column_names) == set(info["features"])
    assert len(data) == info["total_frames"] > 50
    np.testing.assert_allclose(np.diff(data["timestamp"].to_numpy()), 1 / 15, atol=1e-5)
    action, names = data["action"][0].as_py(), info["features"]["observation.state"]["names"]
    assert info["features"]["action"]["names"] == names[:8]
    for column in ("observation.state", "action"):
        poses = np.array(data[column].to_pylist())[
            :, [names.index(name) for name in ("qx", "qy", "qz", "qw")]
        ]
        assert not changes_sign(poses)
        assert poses.std(axis=0).max() < 0.1
    first = data["observation.state"][0].as_py()
    assert first[:7] == pytest.approx(action[:7], abs=0.05)
    assert abs(first[7] - action[7]) <= 1.0, "counts: the fingers tighten meanwhile"
    assert data["observation.state"][1].as_py()[:8] == action
    stored = {frame.jpeg for frame in recorded_frames(quick_tips / "lifts/001.mcap", "SIM-D0001")}
    kept = [image["bytes"] for image in data["observation.images.finger_b"].to_pylist()]
    assert set(kept) <= stored
    assert len(set(kept)) == len(kept)
    last = [arm.wrench for arm in recorded_arm_states(quick_tips / "lifts/001.mcap") if arm.wrench][-1]
    assert names[8:] == ["force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm"]
    assert data["observation.state"][-1].as_py()[10] == pytest.approx(last[2], abs=1.0)
    row = read_finished_lifts(quick_tips)[0]
    angles = np.array(data["observation.angle"].to_pylist())
    assert info["features"]["observation.angle"]["names"] == ["angle_deg", "sigma_deg", "known"]
    assert angles[-1, 0] == pytest.approx(row.final_estimate_deg, abs=1.0)
    assert set(angles[:, 2]) <= {0.0, 1.0}
    assert (angles[angles[:, 2] == 0.0, 1] == 180.0).all()
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


def test_lerobot_data_set_has_the_tactile_frames_between_its_steps(quick_tips: Path, lerobot: Path) -> None:
    from pyarrow import parquet

    data = parquet.read_table(lerobot / "data/chunk-000/file-000.parquet")
    ages = np.array(data["observation.tactile.finger_b.age_s"].to_pylist())
    assert ages.shape == (len(data), 2)
    newest, before = (
        [image["bytes"] for image in data[key].to_pylist()]
        for key in ("observation.images.finger_b", "observation.tactile.finger_b.1")
    )
    frames = {
        frame.jpeg: frame.time_ns for frame in recorded_frames(quick_tips / "lifts/001.mcap", "SIM-D0001")
    }
    times = np.array([[frames[a], frames[b]] for a, b in zip(newest, before, strict=True)]) / NS_PER_S
    np.testing.assert_allclose(times[:, 0] - times[:, 1], ages[:, 1] - ages[:, 0], atol=1e-5)
    used = sorted({*newest, *before}, key=frames.__getitem__)
    during = [jpeg for jpeg, taken in frames.items() if frames[used[0]] <= taken <= frames[used[-1]]]
    assert len(used) >= 0.98 * len(during)
    assert "observation.tactile.camera.1" not in data.column_names


def test_lerobot_loader_reads_the_data_set(one_lift: Path, tmp_path: Path) -> None:
    module: Any = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="lerobot (with torch) is not installed"
    )
    export_session(one_lift, "lerobot", tmp_path / "out")
    data = module.LeRobotDataset("rig/lifts", root=tmp_path / "out")
    assert data.num_episodes == 1
    assert tuple(data[0]["observation.images.camera"].shape) == (3, 480, 640)


ROS_TOPICS = {
    "/image/SIM-C0001": ["/camera/image_raw/compressed", "/camera/camera_info"],
    "/image/SIM-D0001": ["/finger_b/image_raw/compressed"],
    "/image/SIM-D0002": ["/finger_c/image_raw/compressed"],
    "/arm/tcp": ["/tf"],
    "/arm/joints": ["/joint_states", "/wrench"],
    "/gripper": ["/gripper/joint_states"],
    "/angle/estimate": ["/angle/estimate"],
    "/angle/truth": ["/angle/markers"],
    "/angle/SIM-D0001": ["/angle/finger_b"],
    "/angle/SIM-D0002": ["/angle/finger_c"],
}


@pytest.fixture(scope="module")
def bag(one_lift: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bags") / "out"
    exported = export_session(one_lift, "rosbag2", out)
    assert exported.notes == ("SIMULATED ROS 2 bags (MCAP); angles in rad",)
    assert [path.name for path in out.iterdir()] == ["001"]
    return out / "001"


def ros_messages(bag: Path) -> dict[str, list[Any]]:
    """The messages of a bag by topic, in order of time, as mcap-ros2-support reads them."""
    messages: dict[str, list[Any]] = {}
    with (bag / "001.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    return messages


def stamp_ns(message: Any) -> int:
    stamp = (message.transforms[0] if hasattr(message, "transforms") else message).header.stamp
    return stamp.sec * NS_PER_S + stamp.nanosec


@pytest.mark.heavy
def test_bag_has_every_message_with_the_stamp_of_the_recording(one_lift: Path, bag: Path) -> None:
    wanted: dict[str, list[int]] = {}
    with (one_lift / "lifts/001.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            for topic in ROS_TOPICS.get(channel.topic, []):
                wanted.setdefault(topic, []).append(message.publish_time)
    wanted = {topic: sorted(times) for topic, times in wanted.items()}
    assert {topic for topics in ROS_TOPICS.values() for topic in topics} == set(wanted)
    start = min(times[0] for times in wanted.values())
    assert start > SIMULATED_EPOCH_NS
    found = {topic: [stamp_ns(each) for each in of] for topic, of in ros_messages(bag).items()}
    assert len(found.pop("/tf_static")) == 1
    assert found == wanted
    logged: dict[str, list[int]] = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, data in reader.messages():
            assert stamp_ns(reader.deserialize(data, connection.msgtype)) == time_ns
            logged.setdefault(connection.topic, []).append(time_ns)
        (static,) = [each for each in reader.connections if each.topic == "/tf_static"]
        assert isinstance(static.ext, ConnectionExtRosbag2)
        assert [each.durability.name for each in static.ext.offered_qos_profiles] == ["TRANSIENT_LOCAL"]
    assert logged.pop("/tf_static")[0] <= start
    assert logged == wanted
    assert "simulated: SIMULATED" in (bag / "metadata.yaml").read_text()


def test_bag_has_the_values_of_the_recording_in_units_and_frames_of_ros(one_lift: Path, bag: Path) -> None:
    messages, recording = ros_messages(bag), one_lift / "lifts/001.mcap"
    bench = read_manifest_of(one_lift, TrialManifest, "").config
    frames = list(recorded_frames(recording, "SIM-D0002"))
    images = messages["/finger_c/image_raw/compressed"]
    assert [image.data for image in images] == [frame.jpeg for frame in frames]
    assert {(image.format, image.header.frame_id) for image in images} == {("jpeg", "finger_c_optical_frame")}
    info, model = messages["/camera/camera_info"][0], bench.camera_model()
    assert (info.width, info.height, info.distortion_model) == (*model.size, "plumb_bob")
    assert info.k == model.matrix.ravel().tolist()
    assert info.header.frame_id == "camera_optical_frame"
    hand_eye, table = messages["/tf_static"][0].transforms
    assert (hand_eye.header.frame_id, hand_eye.child_frame_id) == ("base", "camera_optical_frame")
    assert pose_of(hand_eye) == bench.base_T_camera()
    assert table.child_frame_id == "table"
    states, continuous = list(recorded_arm_states(recording)), ContinuousPoses()
    for state, tf, joints, wrench in zip(
        states, messages["/tf"], messages["/joint_states"], messages["/wrench"], strict=True
    ):
        (tool,) = tf.transforms
        assert (tool.header.frame_id, tool.child_frame_id) == ("base", "tool")
        assert pose_of(tool) == continuous.next(state.base_T_tcp)
        assert (joints.name[0], tuple(joints.position)) == ("shoulder_pan_joint", state.joints_rad)
        assert wrench.header.frame_id == "tool"
        parts = (wrench.wrench.force, wrench.wrench.torque)
        turned = [state.base_T_tcp.rotation.apply([v.x, v.y, v.z]) for v in parts]
        assert state.wrench == pytest.approx(np.ravel(turned), abs=1e-12)
    gripper = messages["/gripper/joint_states"][-1]
    opening_m, counts = gripper.position
    assert gripper.name == ["gripper_opening", "gripper_counts"]
    assert opening_m == bench.gripper_spec().opening_at(counts - bench.gripper.limits.min_counts)
    for source, name in ((FUSED, "estimate"), (MARKERS, "markers")):
        stored = recorded_angles(recording, source)[source]
        wanted = np.radians(np.column_stack([stored.angle_deg, stored.sigma_deg]))
        assert np.isfinite(wanted[:, 0]).any()
        assert {tuple(each.name) for each in messages[f"/angle/{name}"]} == {("angle", "angle_sigma")}
        np.testing.assert_array_equal([each.position for each in messages[f"/angle/{name}"]], wanted)


def pose_of(message: Any) -> Pose:
    place, turn = message.transform.translation, message.transform.rotation
    return Pose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))


@pytest.mark.heavy
def test_exported_bag_is_read_as_the_frames_of_the_recording(one_lift: Path, bag: Path) -> None:
    frames = list(read_frames(bag, topic="/finger_b/image_raw/compressed"))
    stored = list(recorded_frames(one_lift / "lifts/001.mcap", "SIM-D0001"))
    later_ns = {read.time.time_ns - kept.time_ns for read, kept in zip(frames, stored, strict=True)}
    assert later_ns == {SIMULATED_EPOCH_NS}
    assert all(np.array_equal(read.image, kept.image) for read, kept in zip(frames, stored, strict=True))


def test_stamps_after_2038_are_rejected(one_lift: Path, tmp_path: Path) -> None:
    session = tmp_path / "session"
    shutil.copytree(one_lift, session)
    written_again(session / "lifts/001.mcap", lambda name: [(name, 2**31 * NS_PER_S)])
    with pytest.raises(SessionError, match="has a time after 2038, too late for ROS stamps; use --to csv"):
        export_session(session, "rosbag2", tmp_path / "out")


def test_missing_extra_is_named_with_the_command_that_installs_it(
    one_lift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs rosbags: pip install .*\[ros2\]"):
        export_session(one_lift, "rosbag2", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_failed_export_leaves_no_files(one_lift: Path, recording: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(one_lift, broken)
    file = broken / "lifts/001.mcap"
    file.write_bytes(file.read_bytes()[:200_000])
    for to in ("csv", "coco", "rosbag2"):
        with pytest.raises(SessionError, match=r"001\.mcap"):
            export_session(broken, to, tmp_path / "out")
    with pytest.raises(InputError, match="no episodes"):
        export_session(recording, "lerobot", tmp_path / "out")
    with pytest.raises(InputError, match="no lifts; use --to coco"):
        export_session(recording, "rosbag2", tmp_path / "out")
    with pytest.raises(InputError, match="choose one of csv"):
        export_session(one_lift, "excel", tmp_path / "out")
    with pytest.raises(InputError, match="there is no such session folder"):
        export_session(tmp_path / "nothing", "csv", tmp_path / "out")
    assert {path.name for path in tmp_path.iterdir()} == {"broken"}
    with pytest.raises(InputError, match="exists already"):
        export_session(one_lift, "csv", tmp_path / "broken")
