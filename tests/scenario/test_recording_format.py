"""Recordings as they are, opened by what other people's viewers are made of."""

import json
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader


def test_recordings_carry_foxgloves_own_schemas(one_lift: Path) -> None:
    """What a viewer reads is the schema inside the file, so that is what is compared."""
    known = {"foxglove.CompressedImage": CompressedImage, "foxglove.PoseInFrame": PoseInFrame}
    with (one_lift / "lifts/001.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
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


def test_messages_fit_the_json_schemas_beside_them(one_lift: Path) -> None:
    kinds = {
        "string": str,
        "number": (int, float),
        "integer": int,
        "boolean": bool,
        "array": list,
        "null": type(None),
    }
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


def test_rerun_opens_a_recording_as_it_is(one_lift: Path) -> None:
    pytest.importorskip("rerun", reason="the viewer's library is not installed: extra 'live'")
    from rerun.chunk import McapReader

    chunks = list(McapReader(one_lift / "lifts/001.mcap").stream().to_chunks())
    paths = {chunk.entity_path for chunk in chunks}
    assert {"/image/SIM-D0001", "/image/SIM-C0001", "/arm/tcp"} <= paths
