"""Recordings are opened with the libraries of third-party viewers."""

import json
from datetime import UTC, date, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader

from rig.config import BenchConfig
from rig.sessions.about import SIMULATED_EPOCH_NS
from rig.sessions.reading import recorded_frames
from rig.sessions.recording_file import recorded_messages
from rig.sessions.rows import read_finished_lifts


def test_recordings_contain_foxglove_schemas(one_lift: Path) -> None:
    """Compare with the schemas inside the file, because viewers read these."""
    known = {
        "foxglove.CompressedImage": CompressedImage, "foxglove.PoseInFrame": PoseInFrame,
        "foxglove.CameraCalibration": CameraCalibration, "foxglove.FrameTransforms": FrameTransforms,
        "foxglove.ImageAnnotations": ImageAnnotations,
    }  # fmt: skip
    with (one_lift / "lifts/001.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    found: set[str] = set()
    for schema in summary.schemas.values():
        if schema.encoding == "jsonschema":
            assert json.loads(schema.data)["type"] == "object"
            continue
        stored = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
        expected = FileDescriptorProto()
        known[schema.name].DESCRIPTOR.file.CopyToProto(expected)
        assert stored[expected.name] == expected
        assert set(expected.dependency) <= set(stored)
        found.add(schema.name)
    assert found == set(known)


def test_recording_holds_its_metadata_camera_frames_and_outlines(
    one_lift: Path, light_bench: BenchConfig
) -> None:
    path = one_lift / "lifts/001.mcap"
    row = read_finished_lifts(one_lift)[0]
    with path.open("rb") as stream:
        reader = make_reader(stream)
        (about,) = reader.iter_metadata()
        said = {
            "object": "t2", "name": "toothbrush", "lift": "1", "seed": str(row.seed),
            "simulated": "SIMULATED", "estimator": "slip", "bench": light_bench.name,
        }  # fmt: skip
        assert said.items() <= about.metadata.items()
        assert about.metadata["tool_version"][0].isdigit()
        assert not any(str(one_lift.parent) in value for value in about.metadata.values())
        messages = [(channel.topic, message) for _, channel, message in reader.iter_messages()]
    by_topic = dict(messages)
    camera = CameraCalibration.FromString(by_topic["/camera/calibration"].data)
    assert (camera.K[0], camera.width) == (light_bench.camera.focal_px, light_bench.camera.size_px[0])
    frames = FrameTransforms.FromString(by_topic["/tf"].data).transforms
    assert {(f.parent_frame_id, f.child_frame_id) for f in frames} == {
        ("base", "SIM-C0001"),
        ("base", "table"),
    }
    placed = light_bench.base_T_camera().position_m
    assert (frames[0].translation.x, frames[0].translation.z) == (placed[0], placed[2])
    outlines = [ImageAnnotations.FromString(m.data) for t, m in messages if t == "/contact/SIM-D0001"]
    drawn = [outline.points[0].points for outline in outlines if outline.points]
    assert len(drawn) > 20
    areas = [cv2.contourArea(np.array([(p.x, p.y) for p in points], np.float32)) for points in drawn]
    assert float(np.median(areas)) == pytest.approx(row.contact_area_px["SIM-D0001"], rel=0.35)


def test_times_are_dates_of_one_epoch_and_inside_those_of_the_bench(one_lift: Path) -> None:
    path = one_lift / "lifts/001.mcap"
    with path.open("rb") as stream:
        dates = [
            message.publish_time for _, _, message in make_reader(stream).iter_messages(log_time_order=False)
        ]
    times = [time_ns for _, time_ns, _, _ in recorded_messages(path)]
    assert {date - time_ns for date, time_ns in zip(dates, times, strict=True)} == {SIMULATED_EPOCH_NS}
    assert datetime.fromtimestamp(min(dates) / 1e9, UTC).date() == date(2000, 1, 1)
    frame = next(recorded_frames(path, "SIM-D0001"))
    with path.open("rb") as stream:
        first = next(make_reader(stream).iter_messages(["/image/SIM-D0001"]))[2]
    stamp = CompressedImage.FromString(first.data).timestamp.ToNanoseconds()
    assert stamp == first.log_time == frame.time_ns + SIMULATED_EPOCH_NS


def test_messages_match_their_json_schemas(one_lift: Path) -> None:
    kinds = {
        "string": str, "number": (int, float), "integer": int, "boolean": bool, "array": list,
        "null": type(None),
    }  # fmt: skip
    seen: set[str] = set()
    with (one_lift / "lifts/001.mcap").open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            if schema is None or schema.encoding != "jsonschema":
                continue
            properties = json.loads(schema.data)["properties"]
            for name, value in json.loads(message.data).items():
                allowed = properties[name]["type"]
                allowed = [allowed] if isinstance(allowed, str) else allowed
                assert any(isinstance(value, kinds[kind]) for kind in allowed), (schema.name, name, value)
            seen.add(schema.name)
    assert seen == {"rig.Phase", "rig.Joints", "rig.Gripper", "rig.Angle"}


def test_rerun_opens_a_recording_unchanged(one_lift: Path) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import McapReader

    chunks = list(McapReader(one_lift / "lifts/001.mcap").stream().to_chunks())
    paths = {chunk.entity_path for chunk in chunks}
    assert {"/image/SIM-D0001", "/image/SIM-C0001", "/arm/tcp"} <= paths
