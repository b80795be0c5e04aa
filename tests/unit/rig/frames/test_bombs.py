"""Files that become very large when decompressed are refused by name, before they take memory or disk."""

import bz2
import tracemalloc
import zipfile
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from drivers.errors import FormatError, InputError
from drivers.formats import check_pieces, check_unpacked, unpacking
from rig.frames.series import read_frames

ZEROS = bytes(6_000_000)
MESSAGE = "sensor_msgs/msg/CompressedImage"


@pytest.fixture
def small_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 2_000_000)


def message_of(store, data: bytes) -> object:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](1, 0)
    more = {"seq": 0} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **more)
    return types[MESSAGE](header, "png", np.frombuffer(data, np.uint8))


def bag2(path: Path, plugin: StoragePlugin, mode: CompressionMode, data: bytes) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer2(path, version=8, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/image", MESSAGE, typestore=store)
        writer.write(connection, 10**9, store.serialize_cdr(message_of(store, data), MESSAGE))
    return path


def bag1(path: Path, kind: str, data: bytes) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    writer.set_compression(getattr(writer.CompressionFormat, kind))
    with writer:
        connection = writer.add_connection("/image", MESSAGE, typestore=store)
        writer.write(connection, 10**9, store.serialize_ros1(message_of(store, data), MESSAGE))
    return path


@pytest.mark.heavy
@pytest.mark.parametrize("data", [ZEROS, np.random.default_rng(1).bytes(3_000_000)])
@pytest.mark.parametrize(
    "name",
    ["mcap-storage", "mcap-message", "mcap-file", "sqlite3-message", "sqlite3-file", "ros1-BZ2", "ros1-LZ4"],
)
def test_bag_is_read_only_if_it_stays_below_the_limit(
    tmp_path: Path, small_limit: None, name: str, data: bytes
) -> None:
    storage, mode = name.split("-")
    if storage == "ros1":
        path = bag1(tmp_path / "x.bag", mode, data)
    else:
        path = bag2(tmp_path / "x", StoragePlugin[storage.upper()], CompressionMode[mode.upper()], data)
    with pytest.raises(InputError) as raised:  # also for the good bag, whose data are no image
        list(read_frames(path))
    assert ("when decompressed, and the limit is" in str(raised.value)) == (data is ZEROS)
    assert ("not one complete image in 1 message" in str(raised.value)) == (data is not ZEROS)


@pytest.mark.parametrize("suffix", [".npz", ".npy"])
def test_array_is_read_only_if_it_stays_below_the_limit(
    tmp_path: Path, small_limit: None, suffix: str
) -> None:
    frames = np.zeros((60, 200, 200, 3), np.uint8)
    path = tmp_path / f"x{suffix}"
    np.savez_compressed(path, frames) if suffix == ".npz" else np.save(path, frames)
    if suffix == ".npy":
        assert len(list(read_frames(path))) == 60
        return
    with pytest.raises(FormatError, match=r"x\.npz: 0\.\d+ MB become 7 MB or more when decompressed"):
        read_frames(path)


def frame_of(kind: str, data: bytes) -> bytes:
    if kind == "bz2":
        return bz2.compress(data)
    if kind == "lz4":
        return lz4.frame.compress(data)
    return zstandard.ZstdCompressor(write_content_size=False).compress(data)


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_size_is_counted_without_decompressing_everything(kind: str) -> None:
    bomb = frame_of(kind, bytes(40_000_000)) * 8
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"x: .* MB become 25\d MB or more when decompressed"):
        check_pieces("x", len(bomb), [(kind, frame_of(kind, b"")), (kind, bomb)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd", "none"])
def test_real_and_damaged_data_are_accepted(kind: str) -> None:
    data = frame_of(kind, np.random.default_rng(0).bytes(100_000))
    check_pieces("x", len(data), [(kind, data), (kind, data[:-200]), (kind, b"nonsense"), (kind, b"")])


def test_large_files_may_be_large() -> None:
    check_unpacked("x", 10**9, 40 * 10**9)
    with pytest.raises(FormatError, match="limit is 50000 MB"):
        check_unpacked("x", 10**9, 51 * 10**9)


def test_stored_look_of_a_gel_is_limited(tmp_path: Path, small_limit: None) -> None:
    from calibration.gel.look import load_look
    from drivers.errors import CalibrationError

    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("background.npy", ZEROS)
    with pytest.raises(CalibrationError, match="when decompressed"):
        load_look(tmp_path / "x.npz")
