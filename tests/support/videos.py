"""Videos of variable frame rate: written by OpenCV, then their frames get other presentation times."""

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
CODECS = {".mkv": "FFV1", ".webm": "VP80", ".mp4": "mp4v", ".mov": "mp4v", ".avi": "FFV1"}
FPS = 25.0
_MASTERS = (b"\x18\x53\x80\x67", b"\x1f\x43\xb6\x75", b"\xa0")
_TIMECODE, _BLOCKS = b"\xe7", (b"\xa3", b"\xa1")


def write_video(path: Path, images: Sequence[Image], times_ms: Sequence[int] | None = None) -> Path:
    """Write RGB images as a video; FFV1 in .mkv is lossless. times_ms: of the frames, else 25 a second."""
    size = (images[0].shape[1], images[0].shape[0])
    codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, FPS, size)
    assert writer.isOpened()
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    if times_ms is not None:
        data = bytearray(path.read_bytes())
        path.write_bytes(
            _iso(data, times_ms) if path.suffix in (".mp4", ".mov") else _matroska(data, times_ms)
        )
    return path


def _matroska(data: bytearray, times_ms: Sequence[int]) -> bytes:
    """Set the times of the blocks, which are 16 bits relative to their cluster."""
    cluster_ms, times = 0, iter(times_ms)
    for name, begin, end in _elements(data, 0, len(data)):
        if name == _TIMECODE:
            cluster_ms = int.from_bytes(data[begin:end], "big")
        elif name in _BLOCKS:
            struct.pack_into(">h", data, begin + 1, next(times) - cluster_ms)
    assert next(times, None) is None
    return bytes(data)


def _elements(data: bytearray, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    while at < end:
        width = 9 - data[at].bit_length()
        name, at = bytes(data[at : at + width]), at + width
        width = 9 - data[at].bit_length()
        size = int.from_bytes(data[at : at + width], "big") - (1 << 7 * width)
        at += width
        yield name, at, at + size
        if name in _MASTERS:
            yield from _elements(data, at, at + size)
        at += size


def _iso(data: bytearray, times_ms: Sequence[int]) -> bytes:
    """Replace the table of durations (stts) of an MP4 file, whose header (moov) is at its end."""
    place = data.index(b"stts") - 4
    (old,) = struct.unpack_from(">I", data, place)
    scale_at = data.index(b"mdhd") + 16
    (scale,) = struct.unpack_from(">I", data, scale_at)
    steps = [*np.diff(times_ms), 40]
    rows = b"".join(struct.pack(">II", 1, round(step * scale / 1000)) for step in steps)
    table = struct.pack(">I4sII", 16 + len(rows), b"stts", 0, len(steps)) + rows
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        box = data.index(name, data.index(b"moov")) - 4
        struct.pack_into(">I", data, box, struct.unpack_from(">I", data, box)[0] + len(table) - old)
    # the edit list ends the presentation after its duration, in ms
    struct.pack_into(">I", data, data.index(b"elst") + 12, times_ms[-1] + 40)
    return bytes(data[:place]) + table + bytes(data[place + old :])
