"""Recordings are read as written, or rejected as damaged."""

import io
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from drivers.errors import SessionError
from protocols.observer import LiftObserver
from rig.sessions import recording_file
from rig.sessions.reading import (
    phase_times,
    recorded_angles,
    recorded_frames,
    recorded_gripper,
    recorded_reaction,
    show_again,
)
from rig.sessions.recorder import FUSED_TOPIC
from rig.sessions.recording_file import MOST_CHUNK, check_recording, recorded_messages
from rig.tactile.angles import FUSED
from support.command_line import refusal
from support.recordings import Edit, written_again

Drawn = Callable[..., Path]
SECTOR = 512
STORED = Path(__file__).parents[3] / "data" / "stored_trial"
RNG = np.random.default_rng(10)


def flipped_bit(data: bytearray, place: int) -> None:
    data[place] ^= 1 << (place % 8)


def other_byte(data: bytearray, place: int) -> None:
    data[place] = (data[place] + 1 + place % 255) % 256


def empty_sector(data: bytearray, place: int) -> None:
    begin = place // SECTOR * SECTOR
    data[begin : begin + SECTOR] = bytes(len(data[begin : begin + SECTOR]))


def lost_sector(data: bytearray, place: int) -> None:
    begin = place // SECTOR * SECTOR
    del data[begin : begin + SECTOR]


@pytest.fixture(scope="module")
def whole(drawn_trial: Drawn, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording of 0.5 MB."""
    folder = drawn_trial(tmp_path_factory.mktemp("recording") / "s", (12.0,))
    return (folder / "lifts" / "001.mcap").read_bytes()


@pytest.mark.parametrize("damage", [flipped_bit, other_byte, empty_sector, lost_sector])
def test_damage_is_reported_and_no_wrong_message_is_read(
    whole: bytes, tmp_path: Path, damage: Callable[[bytearray, int], None]
) -> None:
    path = tmp_path / "001.mcap"
    path.write_bytes(whole)
    messages = list(recorded_messages(path))
    for place in RNG.integers(0, len(whole), 40):
        data = bytearray(whole)
        damage(data, int(place))
        assert data != whole
        path.write_bytes(data)
        with pytest.raises(SessionError, match=r"001\.mcap: the recording is damaged \(.+\)"):
            check_recording(path)
        seen = []
        try:
            seen.extend(recorded_messages(path))
        except SessionError:
            assert seen == messages[: len(seen)]
        else:
            assert seen == messages  # the damage is where no message is


def test_flipped_bit_anywhere_in_a_recording_is_detected(tmp_path: Path) -> None:
    path = tmp_path / "small.mcap"
    whole = written([(b"abc", 1), (b"de", 2)])
    for place in range(len(whole)):
        data = bytearray(whole)
        flipped_bit(data, place)
        path.write_bytes(data)
        with pytest.raises(SessionError, match="the recording is damaged"):
            check_recording(path)
    path.write_bytes(whole)
    check_recording(path)


def test_gripper_messages_of_every_gripper_are_read_and_need_a_position() -> None:
    path = Path("001.mcap")
    for keys, expected in (
        (b'"position_counts":120,"current_counts":4', (None, 120, 4)), (b'"current_a":0.2', (0.2, None, None))
    ):  # fmt: skip
        kept = recorded_gripper(b'{"opening_m":0.05,"moving":false,' + keys + b"}", path)
        assert kept.opening_m == 0.05
        assert (kept.current_a, kept.position_counts, kept.current_counts) == expected
    assert recorded_gripper(b'{"opening_m":-0.0014,"moving":false}', path).opening_m == 0.0
    for read, message in ((recorded_reaction, b'{"step":"closed"}'), (recorded_gripper, b'{"moving":false}')):
        with pytest.raises(SessionError, match=r"001\.mcap: the recording is damaged"):
            read(message, path)


def test_messages_equal_those_of_the_mcap_library(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "001.mcap"
    path.write_bytes(whole)
    for topics in ((), ("/phase",), (FUSED_TOPIC, "/image/T1"), ("/nothing",)):
        with path.open("rb") as stream:
            expected = [
                (channel.topic, message.publish_time, message.sequence, message.data)
                for _, channel, message in make_reader(stream).iter_messages(
                    topics or None, log_time_order=False
                )
            ]
        assert list(recorded_messages(path, *topics)) == expected


@pytest.mark.parametrize("packed", [CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("said", ["truth", "a small size"])
def test_compressed_recordings_are_read_and_bombs_are_rejected_before_unpacking(
    tmp_path: Path, packed: CompressionType, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = [(os.urandom(3000), n) for n in range(40)]
    (tmp_path / "packed.mcap").write_bytes(written(messages, packed))
    read = recorded_messages(tmp_path / "packed.mcap")
    assert [(data, time_ns) for _, time_ns, _, data in read] == messages
    check_recording(tmp_path / "packed.mcap")
    most: list[int] = []
    unpacked = recording_file._decompress
    monkeypatch.setattr(recording_file, "_decompress", lambda c: most.append(len(d := unpacked(c))) or d)
    path = tmp_path / "bomb.mcap"
    data = written([(bytes(2_000_000), 1)] * 40, packed, chunk=100_000_000)
    assert len(data) < 400_000
    path.write_bytes(data if said == "truth" else sized(data, 5000))
    with pytest.raises(SessionError, match=r"would become|bytes instead of 5000|damaged"):
        list(recorded_messages(path))
    assert sum(most) <= 5001


@pytest.mark.parametrize(
    ("ns", "size", "said"),
    [(1, MOST_CHUNK + 1, "exceeds the limit"), (2**63, 0, "64 bits"), (2**64 - 1, 0, "beyond 64 bits")],
)
def test_large_chunk_and_late_time_are_damage(tmp_path: Path, ns: int, size: int, said: str) -> None:
    path, data = tmp_path / "odd.mcap", written([(os.urandom(1000), ns)])
    path.write_bytes(sized(data, size) if size else data)
    with pytest.raises(SessionError, match=said):
        list(recorded_messages(path))


@pytest.mark.heavy
@pytest.mark.parametrize(
    "command",
    [
        ("export", "--to", "csv", "--out", "{out}"),
        ("export", "--to", "labelme", "--out", "{out}"),
        ("estimate", "--estimator", "pca", "--out", "{out}"),
    ],
)
def test_commands_use_the_rest_of_a_damaged_recording_and_exit_with_2(
    damaged_stored_trial: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    name, *options = (word.format(out=tmp_path / "out") for word in command)
    done = refusal(name, damaged_stored_trial, *options)
    last = done.splitlines()[-1]
    assert last.startswith("rig: done, except for broken inputs: ")
    assert "002.mcap: the recording is damaged (chunk " in last
    assert any((tmp_path / "out").rglob("*001*" if "labelme" in options or name == "estimate" else "*"))


@pytest.fixture
def damaged_stored_trial(tmp_path: Path, stored_trial_twice: Callable[[Path], Path]) -> Path:
    """Two lifts, the second one's recording with a flipped bit in an image."""
    folder = stored_trial_twice(tmp_path / "trial")
    file = folder / "lifts" / "002.mcap"
    data = bytearray(file.read_bytes())
    flipped_bit(data, len(data) // 3)
    file.write_bytes(data)
    return folder


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        ("/image/T1", b"\xff"), ("/image/T1", b""), ("/arm/tcp", b"\xff"), ("/phase", b"null"),
        ("/phase", b'{"phase": "B"}'), ("/phase", b"[" * 100_000), ("/arm/joints", b"{}"),
        ("/arm/joints", b'{"joints_rad": [1e999,0,0,0,0,0], "wrench": [0,0,0,0,0,0], "mode": "running"}'),
        ("/other", b""),
    ],
)  # fmt: skip
def test_invalid_messages_are_damage_despite_valid_checksums(tmp_path: Path, topic: str, data: bytes) -> None:
    path = tmp_path / "odd.mcap"
    path.write_bytes(written([(data, 1)], topic=topic))
    check_recording(path)
    watch = Mock(spec=LiftObserver)
    for read in (lambda: show_again(path, watch), lambda: phase_times(path)):
        with pytest.raises(SessionError, match=r"odd\.mcap: "):
            read()
    if topic == "/image/T1":
        with pytest.raises(SessionError, match=r"odd\.mcap: "):
            list(recorded_frames(path, "T1"))
    assert not len(recorded_angles(path, FUSED)[FUSED])


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda name: [] if name == "C" else [(name, 0)], "phase lower out of order"),
        (lambda name: [] if name == "lower" else [(name, 0)], "phase lower is missing"),
        (lambda name: [(name, 0), (name, 1)], "phase reference out of order"),
        (lambda name: [(name, -(10**9))] if name == "C" else [(name, 0)], "phase C out of order"),
        (lambda name: [(name, 0), ("settle", 1)] if name == "A" else [(name, 0)], "the recording is damaged"),
    ],
    ids=["left out", "last left out", "twice", "back in time", "unknown"],
)
def test_recording_without_the_phases_in_order_is_refused(tmp_path: Path, edit: Edit, said: str) -> None:
    path = tmp_path / "001.mcap"
    shutil.copy(STORED / "lifts" / "001.mcap", path)
    written_again(path, edit)
    with pytest.raises(SessionError, match=said):
        phase_times(path)


def written(
    messages: list[tuple[bytes, int]],
    packed: CompressionType = CompressionType.NONE,
    chunk: int = 100_000,
    topic: str = "/image/T1",
) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=chunk, compression=packed, enable_data_crcs=True)
    writer.start()
    schema = writer.register_schema("x", "", b"")
    channel = writer.register_channel(topic, "json", schema)
    for data, time_ns in messages:
        writer.add_message(channel, time_ns, data, time_ns)
    writer.finish()
    return stream.getvalue()


def sized(data: bytes, size: int) -> bytes:
    """Make a recording of one chunk state another size, with matching checksums."""
    with io.BytesIO(data) as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    [index] = summary.chunk_indexes
    old, new = struct.pack("<Q", index.uncompressed_size), struct.pack("<Q", size)
    changed = bytearray(data.replace(old, new))
    begin = struct.unpack("<Q", changed[-28:-20])[0]
    changed[-12:-8] = struct.pack("<I", zlib.crc32(changed[begin:-12]))
    return bytes(changed)
