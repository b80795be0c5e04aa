"""Limits on the size of compressed data after decompression, for every reader of compressed files.

A few kilobytes can decompress to gigabytes. Data may become `MOST_UNPACKED`, or `MOST_RATIO` times their size
in the file if that is more. The size is counted while decompressing, because stated sizes may be wrong.
"""

import bz2
import zipfile
from collections.abc import Callable, Iterable
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
    start = _STARTS.get(kind)
    if start is None:
        yield len(data)
        return
    read = start(data)
    try:
        while size := len(read(_STEP)):
            yield size
    except (zstandard.ZstdError, OSError, EOFError, RuntimeError, ValueError):
        return


def _zstd(data: bytes) -> Callable[[int], bytes]:
    # any window size: only the counted part of it is used, and other decoders accept larger ones
    unpack = zstandard.ZstdDecompressor(max_window_size=1 << 31)
    return unpack.stream_reader(data, read_across_frames=True).read


def _bounded(make: Callable[[], Any], data: bytes) -> Callable[[int], bytes]:
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


_STARTS: dict[str, Callable[[bytes], Callable[[int], bytes]]] = {
    "zstd": _zstd,
    "lz4": lambda data: _bounded(lz4.frame.LZ4FrameDecompressor, data),
    "bz2": lambda data: _bounded(bz2.BZ2Decompressor, data),
}
