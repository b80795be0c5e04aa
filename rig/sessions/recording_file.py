"""The messages of a recording (MCAP), each chunk checked against its checksum before it is used.

A read looks at the chunks it needs, which the summary names, and the summary has a checksum too: what comes
back is what was written. `check_recording` looks at every byte. A chunk is unpacked only up to the size
that it may have; the library's own readers unpack whatever a few bytes stand for, and look at no checksum
of a summary. Layout: https://mcap.dev/spec.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex
from mcap.stream_reader import StreamReader

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.formats import reason
from rig.sessions.about import CLOCK_OFFSET

MOST_CHUNK = 64_000_000
"""Bytes of an unpacked chunk; the recorder's hold half a megabyte, and a picture."""
MOST_RATIO = 20
"""How much larger a recording may be unpacked; its pictures are packed already."""
MAGIC = b"\x89MCAP0\r\n"
_LAST_NS = 2**63 - 1
_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_FOOTER, _DATA_END = struct.Struct("<BQQQI"), struct.Struct("<BQI")
_PORTION = 1 << 20
_DAMAGE = (
    McapError, EOFError, OSError, ValueError, KeyError, OverflowError, MemoryError, RuntimeError,
    struct.error, zstandard.ZstdError,
)  # fmt: skip
"""What damaged bytes lead to, here and in the libraries."""

RecordedMessage = tuple[str, int, int, bytes]
"""Topic, time in ns, sequence, data."""


@dataclass(frozen=True, slots=True)
class _Summary:
    """begin: where the summary is. topics, offsets_ns: by channel. chunks: in the order of writing.

    offsets_ns: from the bench's clock to the dates that are stored.
    """

    begin: int
    topics: dict[int, str]
    offsets_ns: dict[int, int]
    chunks: list[ChunkIndex]


def recorded_messages(path: Path, *topics: str) -> Iterator[RecordedMessage]:
    """Yield (topic, time_ns, sequence, data) in the order they were written, of all or some topics.

    time_ns: by the bench's clock, whatever date the file gives it.
    Raises `SessionError` for a recording that is missing, and at the first chunk that is damaged.
    """
    try:
        with path.open("rb") as stream:
            yield from _messages(stream, set(topics))
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except _DAMAGE as error:
        raise SessionError(f"{path}: the recording is damaged ({reason(error)})") from error


def check_recording(path: Path) -> None:
    """Look at every byte of a recording. Raises `SessionError` where one is not as it was written.

    Without a checksum of all data, as recordings had none before, chunks and summary are looked at: whatever
    is read of a recording.
    """
    try:
        with path.open("rb") as stream:
            _check_all(stream)
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except _DAMAGE as error:
        raise SessionError(f"{path}: the recording is damaged ({reason(error)})") from error


def _messages(stream: IO[bytes], topics: set[str]) -> Iterator[RecordedMessage]:
    summary = _summary(stream)
    wanted = {number: topic for number, topic in summary.topics.items() if not topics or topic in topics}
    for number, index in enumerate(summary.chunks, start=1):
        if index.message_index_offsets and wanted.keys().isdisjoint(index.message_index_offsets):
            continue
        for channel, sequence, time_ns, data in _records(_chunk(stream, index, number, len(summary.chunks))):
            if channel in wanted:
                yield wanted[channel], _bench_time(time_ns, summary.offsets_ns[channel]), sequence, data


def _bench_time(time_ns: int, offset_ns: int) -> int:
    if not 0 <= time_ns - offset_ns <= _LAST_NS:
        raise ValueError("a message's time is before its clock's beginning")
    return time_ns - offset_ns


def _check_all(stream: IO[bytes]) -> None:
    summary = _summary(stream)
    stream.seek(summary.begin - _DATA_END.size)
    opcode, length, checksum = _DATA_END.unpack(stream.read(_DATA_END.size))
    if (opcode, length) != (Opcode.DATA_END, 4):
        raise ValueError("its data have no end")
    stream.seek(0)
    if checksum and _checksum(stream, summary.begin - _DATA_END.size) == checksum:
        return
    for number, index in enumerate(summary.chunks, start=1):
        _chunk(stream, index, number, len(summary.chunks))
    if checksum:
        raise ValueError("between its chunks: the checksum differs")


def _summary(stream: IO[bytes]) -> _Summary:
    """Read the summary, which says where everything is."""
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("it begins as no MCAP file does")
    tail = _FOOTER.size + len(MAGIC)
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(size - tail, 0))
    footer = stream.read()
    if footer[-len(MAGIC) :] != MAGIC or len(footer) != tail:
        raise ValueError("it is cut short")
    opcode, _, begin, _, checksum = _FOOTER.unpack_from(footer)
    if opcode != Opcode.FOOTER or not len(MAGIC) + _DATA_END.size <= begin <= size - tail:
        raise ValueError("its end says nothing of what it holds")
    stream.seek(begin)
    data = stream.read()
    # over all but the checksum itself and what follows
    if checksum and zlib.crc32(data[: -len(MAGIC) - 4]) != checksum:
        raise ValueError("its summary: the checksum differs")
    return _checked(begin, data, size)


def _checked(begin: int, data: bytes, size: int) -> _Summary:
    """Take the summary apart; refuse one that stands for more than fits."""
    topics, offsets_ns, chunks = {}, {}, []
    for record in StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
            offsets_ns[record.id] = int(record.metadata.get(CLOCK_OFFSET, "0"))
        elif isinstance(record, ChunkIndex):
            chunks.append(record)
    unpacked = sum(chunk.uncompressed_size for chunk in chunks)
    if unpacked > MOST_RATIO * size or max((c.uncompressed_size for c in chunks), default=0) > MOST_CHUNK:
        raise ValueError(f"{size / 1e6:.1f} MB that stand for {unpacked / 1e6:.0f} MB, more than is unpacked")
    return _Summary(begin, topics, offsets_ns, chunks)


def _chunk(stream: IO[bytes], index: ChunkIndex, number: int, count: int) -> memoryview:
    """Read and unpack a chunk, and hold it to its checksum."""
    where = (
        f"chunk {number} of {count}, {index.message_start_time / NS_PER_S:.2f} to "
        f"{index.message_end_time / NS_PER_S:.2f} s"
    )
    if index.chunk_length > MOST_RATIO * MOST_CHUNK:
        raise ValueError(f"{where}: is larger than any")
    stream.seek(index.chunk_start_offset)
    try:
        record = next(
            StreamReader(io.BytesIO(stream.read(index.chunk_length)), True, emit_chunks=True).records
        )
    except (McapError, ValueError, struct.error, StopIteration) as error:
        raise ValueError(f"{where}: cannot be read") from error
    if not isinstance(record, Chunk) or record.uncompressed_size != index.uncompressed_size:
        raise ValueError(f"{where}: is not what the summary says")
    data = _unpacked(record)
    if len(data) != record.uncompressed_size:
        raise ValueError(f"{where}: {len(data)} bytes where {record.uncompressed_size} are said to be")
    if record.uncompressed_crc and zlib.crc32(data) != record.uncompressed_crc:
        raise ValueError(f"{where}: the checksum differs")
    return memoryview(data)


def _unpacked(chunk: Chunk) -> bytes:
    """Unpack a chunk, up to a byte more than it may have."""
    most = chunk.uncompressed_size + 1
    if chunk.compression == "zstd":
        unpack = zstandard.ZstdDecompressor(max_window_size=MOST_CHUNK)
        return unpack.stream_reader(chunk.data).read(most)
    if chunk.compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    if chunk.compression:
        raise ValueError(f"packed in an unknown way, '{chunk.compression[:20]}'")
    return chunk.data


def _records(data: memoryview) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield (channel, sequence, time_ns, data) of a chunk's messages, one at a time: it may hold millions."""
    at = 0
    while at < len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        begin, at = at + _RECORD.size, at + _RECORD.size + length
        if at > len(data):
            raise ValueError("a message runs over its chunk's end")
        if opcode == Opcode.MESSAGE:
            # its own time is that of publishing; the log's says where it stands in the file
            channel, sequence, _, time_ns = _MESSAGE.unpack_from(data[begin:at])
            if time_ns > _LAST_NS:
                raise ValueError("a message's time is beyond 64 bits")
            yield channel, sequence, time_ns, bytes(data[begin + _MESSAGE.size : at])


def _checksum(stream: IO[bytes], size: int) -> int:
    checksum = 0
    while size > 0:
        portion = stream.read(min(size, _PORTION))
        if not portion:
            raise EOFError("it is cut short")
        checksum, size = zlib.crc32(portion, checksum), size - len(portion)
    return checksum
