"""Readers of sessions, recordings, labels, networks and checkpoints accept a file or raise a typed error."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from calibration.camera.files import read_camera
from drivers.types import Image
from protocols.observer import LiftEvents
from rig.config import load_bench
from rig.config.calibrations import find_calibrations
from rig.config.load import parse_bench
from rig.config.objects import new_object_text, parse_object, with_position
from rig.config.write import bench_text
from rig.frames.clips import array_frames
from rig.frames.times import times_from_table
from rig.labels.label_files import labelme_mask, read_label
from rig.report.curves_page import read_table
from rig.results.listing import list_session
from rig.sessions.reading import recorded_frames, show_again
from rig.sessions.recording_file import check_recording
from rig.tactile.contact.network import load_network
from support.fuzz import BYTES, answered, changed, fuzzed
from support.onnx_bytes import identity_model

STORED = Path(__file__).parents[2] / "data"
JSON = (b"null", b"[]", b"{}", b"-1", b"1e999", b"9" * 25, b'"x"', b"true", b"../../x", b",", b":", b'"',
        b"\xff", b"\\ud800", b"[" * 300, b"$\\frac", b"0", b"1e300")  # fmt: skip


class IgnoresEvents(LiftEvents):
    """Ignores all events."""


NO_OBSERVER = IgnoresEvents()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def recording(packed: CompressionType) -> bytes:
    """A recording of a few messages, as small as they come."""
    stream = io.BytesIO()
    writer = Writer(
        stream, chunk_size=300, compression=packed, enable_data_crcs=packed is CompressionType.NONE
    )
    writer.start()
    schema = writer.register_schema("x", "", b"")
    topics = {
        name: writer.register_channel(name, "json", schema) for name in ("/phase", "/image/D1", "/arm/joints")
    }
    for time_ns, phase in enumerate(("reference", "A", "B", "C", "lower")):
        writer.add_message(topics["/phase"], time_ns, json.dumps({"phase": phase}).encode(), time_ns)
        writer.add_message(topics["/arm/joints"], time_ns, b"{}" * 20, time_ns)
    writer.finish()
    return stream.getvalue()


RECORDINGS = [recording(kind) for kind in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)]


@fuzzed()
@given(data=changed(RECORDINGS))
def test_recordings(place: Path, data: bytes) -> None:
    path = place / "001.mcap"
    path.write_bytes(data)
    answered(lambda: check_recording(path))
    answered(lambda: show_again(path, NO_OBSERVER))


@fuzzed()
@given(
    topic=st.sampled_from(["/phase", "/image/D1", "/arm/tcp", "/arm/joints", "/gripper", "/angle/truth"]),
    data=changed(
        [b'{"phase": "reference"}', b'{"angle_deg": 1.5}', b"\x0a\x04\x08\x01", b""], (*JSON, b"\xff")
    ),
    time_ns=st.integers(0, 2**64 - 1),
)
def test_messages_in_recordings(place: Path, topic: str, data: bytes, time_ns: int) -> None:
    path, stream = place / "odd.mcap", io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start()
    channel = writer.register_channel(topic, "json", writer.register_schema("x", "", b""))
    writer.add_message(channel, time_ns, data, time_ns)
    writer.finish()
    path.write_bytes(stream.getvalue())
    answered(lambda: show_again(path, NO_OBSERVER))
    answered(lambda: list(recorded_frames(path, "D1")))


def array_file(save: Callable[..., None]) -> bytes:
    stream = io.BytesIO()
    save(stream, np.zeros((3, 9, 8, 3), np.uint8))
    return stream.getvalue()


@fuzzed()
@given(
    st.one_of(
        *(
            st.tuples(st.just(ending), changed([array_file(save)], (*BYTES, *JSON)))
            for ending, save in ((".npy", np.save), (".npz", np.savez), (".npz", np.savez_compressed))
        )
    )
)
def test_arrays_of_frames(place: Path, drawn: tuple[str, bytes]) -> None:
    path = place / f"clip{drawn[0]}"
    path.write_bytes(drawn[1])
    answered(lambda: list(array_frames(path)))


MANIFESTS = [(STORED / name / "session.json").read_bytes() for name in ("stored_trial", "stored_record")]
ROWS = [
    (STORED / "stored_trial/lifts.jsonl").read_bytes(),
    (STORED / "stored_record/poses.jsonl").read_bytes(),
]


@fuzzed()
@given(manifest=changed(MANIFESTS, JSON), rows=changed(ROWS, (*JSON, b"\n")))
def test_sessions(place: Path, manifest: bytes, rows: bytes) -> None:
    folder = place / "session"
    folder.mkdir(exist_ok=True)
    (folder / "session.json").write_bytes(manifest)
    for name in ("lifts.jsonl", "poses.jsonl"):
        (folder / name).write_bytes(rows)
    entry = answered(lambda: list_session(folder))
    assert entry is not None
    assert str(entry.problem).encode()  # type: ignore[attr-defined]


BENCH = bench_text(load_bench("wire")).encode()


@fuzzed()
@given(changed([BENCH], (*JSON, b"\n", b"[[x]]\n", b".", b" = ", b"#")))
def test_bench_files(data: bytes) -> None:
    answered(lambda: parse_bench(data.decode("utf-8", "replace"), "x.toml"))


OBJECT = new_object_text("box").encode()
SIMULATED = b"[simulated]\nmass_kg = 0.05\n"


@fuzzed()
@given(changed([OBJECT, OBJECT + SIMULATED], (*JSON, b"\n", b"[[position]]\n", b".", b" = ", b"#")))
def test_object_files(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    answered(lambda: parse_object(text, "x.toml"))
    answered(lambda: with_position(text, "middle", {"offset_m": 0.01}, "x.toml"))


CALIBRATION = b"""closing: {counts: [6, 255], opening_m: [0.12, 0.0]}
pixel_aspect: 0.97
add_to_stream_s: 0.01
calibration:
  {schema: 1, kind: tactile, serials: {tactile: SIM-D0001}, created: '2026-01-01T00:00:00+00:00',
   verdict: good, refusals: [], doubts: [], quality: {}, rejected: [], inputs: {}, software: {}}
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [600, 0, 320, 0, 600, 240, 0, 0, 1]}
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""


@pytest.mark.heavy
@fuzzed()
@given(data=changed([CALIBRATION], (*JSON, b"\n", b".nan", b"- ", b"gripper", b": ")))
def test_calibrations(place: Path, data: bytes) -> None:
    folder = place / "calibrations"
    folder.mkdir(exist_ok=True)
    path = folder / "tactile-SIM-D0001.yaml"
    path.write_bytes(data)
    answered(lambda: find_calibrations(load_bench("fake"), folder))
    answered(lambda: read_camera(path))


TABLES = [
    b"t_s,estimate_deg,truth_deg,sigma_deg\n0,1,2,.1\n0.5,1,nan,\n1,2,2,\n", b"frame,t_s\n0,0\n1,0.5\n",
]  # fmt: skip


@fuzzed()
@given(data=changed(TABLES, (*JSON, b"\n", b";", b"inf", b"1e18", b"-", b"t_s", b"true", b"$x_{$")))
def test_tables(place: Path, data: bytes) -> None:
    path = place / "table.csv"
    path.write_bytes(data)
    answered(lambda: read_table(path))
    answered(lambda: times_from_table(path, ["0", "1"]))


SHAPES = ("polygon", "circle", "rectangle")
LABELS = [
    json.dumps(
        {
            "shapes": [{"points": [[1, 2], [9, 8.5], [3, 9]][:n], "shape_type": kind, "label": "contact"}],
            "imageWidth": 40,
            "imageHeight": 30,
        }
    ).encode()
    for kind, n in zip(SHAPES, (3, 2, 2), strict=True)
]


@fuzzed()
@given(data=changed(LABELS, (*JSON, b"1e15", b"-1e15", b"1e-300", b"[1, 2],")))
def test_labels(place: Path, data: bytes) -> None:
    path = place / "a.json"
    path.write_bytes(data)

    def mask() -> Image:
        return labelme_mask(read_label(path), (30, 40), "a.json")

    found = answered(mask)
    assert found is None or found.shape == (30, 40)  # type: ignore[attr-defined]


NETWORK = identity_model((1, 3, 16, 16), b'{"inputs": "frame", "threshold": 0.5}')


@fuzzed()
@given(data=changed([NETWORK]))
def test_networks(place: Path, data: bytes) -> None:
    path = place / "network.onnx"
    path.write_bytes(data)

    def logits() -> object:
        network = load_network(path)
        width, height = network.size
        return network.logits(np.zeros((3, height, width), np.float32))

    answered(logits)


@fuzzed()
@given(data=st.data())
def test_checkpoints(place: Path, data: st.DataObject) -> None:
    torch = pytest.importorskip("torch", reason="training is the extra 'train'")
    from rig.training.networks import read_state

    whole = place / "whole.pt"
    if not whole.exists():
        torch.save({"state_dict": {"a.weight": torch.zeros(3)}}, whole)
    path = place / "checkpoint.pt"
    path.write_bytes(data.draw(changed([whole.read_bytes()])))
    answered(lambda: read_state(path))
