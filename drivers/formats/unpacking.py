"""Limits on the size of compressed data after decompression, and of the tensors that an ONNX file declares.

A few kilobytes can decompress to gigabytes. Data may become `MOST_UNPACKED`, or `MOST_RATIO` times their size
in the file if that is more. The size is counted while decompressing, because stated sizes may be wrong.
onnxruntime allocates a sparse tensor in full when it opens a file, so declared sizes are read from the
protocol buffers first. Field numbers are those of onnx.proto (ONNX IR version 8).
"""

import bz2
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from drivers.errors import FormatError

MOST_UNPACKED = 256_000_000
"""Decompressed size that is always permitted, bytes."""
MOST_RATIO = 50
"""Largest ratio of decompressed size to size in the file beyond that; raw tactile images reach about 10."""
MOST_NETWORK = 4_000_000_000
"""Memory for intermediate results of all networks in a process, bytes; those of the rig need 0.02 GB."""
_STEP = 1 << 20
"""Bytes decompressed at once while counting."""


def check_unpacked(where: str, packed: int, unpacked: int) -> None:
    """Raise `FormatError` if data exceed the limit. where: their name. packed, unpacked: sizes in bytes."""
    most = max(MOST_UNPACKED, MOST_RATIO * packed)
    if unpacked > most:
        raise FormatError(
            f"{where}: {packed / 1e6:.2f} MB become {unpacked / 1e6:.0f} MB or more when decompressed, and "
            f"the limit is {most / 1e6:.0f} MB: if the data are real, store them without compression"
        )


def check_zip(where: str, archive: zipfile.ZipFile) -> None:
    """Raise `FormatError` if the members of an archive exceed the limit; zipfile enforces their sizes."""
    members = archive.infolist()
    packed = sum(member.compress_size for member in members)
    check_unpacked(where, packed, sum(member.file_size for member in members))


def check_pieces(where: str, packed: int, pieces: Iterable[tuple[str, bytes]]) -> None:
    """Raise `FormatError` if the pieces of a file exceed the limit together.

    packed: size of the file. pieces: (compression, data); compression: zstd, lz4, bz2, or another for none.
    Damaged pieces are counted up to their damage.
    """
    total = 0
    for kind, data in pieces:
        for size in _sizes(kind, data):
            total += size
            check_unpacked(where, packed, total)


def _sizes(kind: str, data: bytes) -> Iterable[int]:
    """Yield the sizes of a piece's decompressed parts."""
    if kind == "zstd":
        # any window size: only the counted part of it is used, and other decoders accept larger ones
        unpack = zstandard.ZstdDecompressor(max_window_size=1 << 31)
        read = unpack.stream_reader(data, read_across_frames=True).read
    elif kind in _DECOMPRESSORS:
        read = _bounded_reader(_DECOMPRESSORS[kind], data)
    else:
        yield len(data)
        return
    try:
        while size := len(read(_STEP)):
            yield size
    except (zstandard.ZstdError, OSError, EOFError, RuntimeError, ValueError):
        return


def _bounded_reader(make: Callable[[], Any], data: bytes) -> Callable[[int], bytes]:
    """Return a reader of streams in a row, each with a decompressor with `decompress(data, max_length)`."""
    unpack = make()

    def read(size: int) -> bytes:
        nonlocal unpack, data
        out = b""
        while not out and (data or not unpack.eof):
            before, data = data, b""
            out = unpack.decompress(before, size)
            if unpack.eof and unpack.unused_data:
                data, unpack = unpack.unused_data, make()
            elif not out:
                break
        return out

    return read


_DECOMPRESSORS = {"lz4": lz4.frame.LZ4FrameDecompressor, "bz2": bz2.BZ2Decompressor}


_INSIDE = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
}
"""Messages that contain tensors, by field number."""
_MERGED = {"model": (7,), "attribute": (5, 6, 22)}
"""Fields that occur once; readers join the contents of several, also their dimensions."""
_DIMS = {"tensor": 1, "sparse": 3}
"""Field of the dimensions."""
_ELSEWHERE = 13
"""Field with a key and value about a tensor that is stored in another file."""
_ELEMENT_BYTES = 8
"""Size of the largest usual element (double, int64)."""
_MOST_ELEMENTS = 1 << 62
"""Products of dimensions are cut off here."""
_VARINT, _LENGTH = 0, 2
_SIZED = {1: 8, 3: 0, 4: 0, 5: 4}
"""Wire types of protocol buffers; those of fixed size with it in bytes. Groups (3, 4) are read as fields."""


def check_onnx(path: Path, data: bytes) -> None:
    """Raise `FormatError` if the tensors that an ONNX file declares exceed the limit together.

    Tensors may be stored in other files in its folder; if one is missing, this is an error too. A damaged
    file is counted up to its damage.
    """
    total, left, packed, others = 0, [("model", memoryview(data))], len(data), set[str]()
    while left:
        kind, message = left.pop()
        count = None if kind in _INSIDE else 1
        found: dict[int, list[memoryview]] = {}
        for number, value in _fields(message):
            if kind == "tensor" and number == _ELSEWHERE and isinstance(value, memoryview):
                name = _text_of(value, "location")
                if name not in (None, *others):
                    others.add(name)
                    packed += _size_beside(path, name)
            if number in _INSIDE.get(kind, ()) and isinstance(value, memoryview):
                found.setdefault(number, []).append(value)
            elif count is not None and number == _DIMS[kind]:
                for size in [value] if isinstance(value, int) else _varints(value):
                    count = min(count * size, _MOST_ELEMENTS)
        for number, parts in found.items():
            if len(parts) > 1 and number in _MERGED.get(kind, ()):
                parts = [memoryview(b"".join(parts))]
            left += [(_INSIDE[kind][number], part) for part in parts]
        total += _ELEMENT_BYTES * (count or 0)
        check_unpacked(str(path), packed, total)


def _text_of(entry: memoryview, key: str) -> str | None:
    """Return the value of an entry of two texts if its key is this, else None."""
    texts = {number: bytes(value) for number, value in _fields(entry) if isinstance(value, memoryview)}
    return texts.get(2, b"").decode("utf-8", "replace") if texts.get(1) == key.encode() else None


def _size_beside(path: Path, name: str) -> int:
    """Return the size of a file with tensors in the folder of an ONNX file, bytes. Raises `FormatError`."""
    other = path.parent / name
    try:
        if other.resolve().is_relative_to(path.parent.resolve()):
            return other.stat().st_size
        why = "is not in its folder"
    except (OSError, ValueError):
        why = "is missing"
    raise FormatError(f"{path}: its weights are in {name[:100]!a}, which {why}: copy both files together")


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field of a message with an integer or a length, up to any damage."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            value, at = _varint(message, at)
            yield number, value
        elif wire == _LENGTH:
            size, at = _varint(message, at)
            yield number, message[at : at + size]
            at += size
        else:
            at += _SIZED.get(wire, len(message))


def _varints(packed: memoryview) -> Iterator[int]:
    at = 0
    while at < len(packed):
        value, at = _varint(packed, at)
        yield value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return the integer at a place, and the place behind it; it ends at the latest with the message."""
    value = shift = 0
    while at < len(message):
        byte = message[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128 or shift > 63:
            break
    return value, at
