"""Check how large a ROS bag is after decompression, before a library decompresses it without a limit.

Compressed are: the chunks of MCAP and of ROS 1 bags; whole files of ROS 2 bags (`.db3.zstd`), which are
unpacked to disk; single messages of ROS 2 bags. Formats: https://mcap.dev/spec, http://wiki.ros.org/Bags/Format/2.0.
"""

import struct
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

from drivers.formats import check_pieces

_MCAP, _ROS1, _ZSTD = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"\x28\xb5\x2f\xfd"
_MCAP_RECORD, _MCAP_CHUNK = struct.Struct("<BQ"), struct.Struct("<QQQII")
_CHUNK, _ROS1_CHUNK = 6, b"op=\x05"
_LENGTH = struct.Struct("<I")


def check_bag_size(path: Path) -> None:
    """Raise `FormatError` if a bag, file or folder, exceeds the limit of `drivers.formats.check_unpacked`."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    for file in files:
        facts = file.stat()
        _check_file(file, facts.st_size, facts.st_mtime_ns)


def check_message_sizes(path: Path, bag: Any) -> None:
    """Raise `FormatError` if the compressed messages of a ROS 2 bag, opened by rosbags, exceed the limit."""
    messages = (
        ("zstd", data)
        for storage in bag.storage.storages
        for _, _, data in storage.messages(storage.connections, None, None)
    )
    check_pieces(str(path), sum(file.stat().st_size for file in path.iterdir()), messages)


@lru_cache(maxsize=64)
def _check_file(path: Path, size: int, changed_ns: int) -> None:
    """Check a file; an unchanged file that was accepted is not checked again."""
    with path.open("rb") as stream:
        begin = stream.read(len(_ROS1))
        if begin.startswith(_MCAP):
            check_pieces(str(path), size, _mcap_chunks(stream, size))
        elif begin == _ROS1:
            check_pieces(str(path), size, _ros1_chunks(stream, size))
        elif begin.startswith(_ZSTD):
            stream.seek(0)
            check_pieces(str(path), size, [("zstd", stream.read())])


def _mcap_chunks(stream: IO[bytes], size: int) -> Iterator[tuple[str, bytes]]:
    at = len(_MCAP)
    while at + _MCAP_RECORD.size <= size:
        stream.seek(at)
        kind, length = _MCAP_RECORD.unpack(stream.read(_MCAP_RECORD.size))
        at += _MCAP_RECORD.size + length
        if kind == _CHUNK and at <= size and length > _MCAP_CHUNK.size:
            record = stream.read(length)
            (name_length,) = _LENGTH.unpack_from(record, 28)
            yield record[32 : 32 + name_length].decode(errors="replace"), record[40 + name_length :]


def _ros1_chunks(stream: IO[bytes], size: int) -> Iterator[tuple[str, bytes]]:
    at = len(_ROS1)
    while at + _LENGTH.size <= size:
        header = _block(stream, at, size)
        at += _LENGTH.size + len(header)
        data_length = _LENGTH.unpack(stream.read(_LENGTH.size))[0] if at + _LENGTH.size <= size else size
        at += _LENGTH.size
        if _ROS1_CHUNK in header and at + data_length <= size:
            kind = next((k for k in ("bz2", "lz4") if f"compression={k}".encode() in header), "")
            yield kind, stream.read(data_length)
        at += data_length


def _block(stream: IO[bytes], at: int, size: int) -> bytes:
    """Return the bytes after a length at a place, as many as the file has."""
    stream.seek(at)
    return stream.read(min(_LENGTH.unpack(stream.read(_LENGTH.size))[0], size))
