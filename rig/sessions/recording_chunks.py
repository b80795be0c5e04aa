"""The chunks of a recording (MCAP): their positions, and their messages, verified with checksums.

A chunk is decompressed only up to its permitted size. The library's own readers decompress without a limit,
and ignore the checksum of a summary. File format: https://mcap.dev/spec.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex
from mcap.stream_reader import StreamReader

from drivers.clock import NS_PER_S
from rig.sessions.about import CLOCK_OFFSET
from rig.sessions.files import MAGIC

MOST_CHUNK = 64_000_000
"""Size limit of a decompressed chunk, bytes; the recorder's chunks have an eighth of a megabyte plus a
picture."""
MOST_RATIO = 20
"""Largest decompression ratio of a recording; its pictures are compressed already."""
LAST_NS = 2**63 - 1
"""Largest time that fits in a signed 64-bit integer."""
RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
FOOTER, DATA_END = struct.Struct("<BQQQI"), struct.Struct("<BQI")
_CHUNK_HEAD = struct.Struct("<QQQII")
DAMAGE = (
    McapError, EOFError, OSError, ValueError, KeyError, OverflowError, MemoryError, RuntimeError,
    struct.error, zstandard.ZstdError,
)  # fmt: skip
"""Exceptions that damaged bytes cause, here and in the libraries."""


@dataclass(slots=True)
class Layout:
    """Positions of a recording's chunks.

    size: of the file, bytes. summary_begin: offset of the summary, None without one. topics, offsets_ns: by
    channel; offsets_ns: from the bench's clock to the stored dates. chunks: in the order of writing.
    """

    size: int
    summary_begin: int | None = None
    topics: dict[int, str] = field(default_factory=dict)
    offsets_ns: dict[int, int] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel, unless its number is already known."""
        self.topics.setdefault(channel.id, channel.topic)
        self.offsets_ns.setdefault(channel.id, int(channel.metadata.get(CLOCK_OFFSET, "0")))

    def where(self, number: int) -> str:
        """Return a text that names a chunk by its number, from 1, and its times since the first chunk."""
        index, first_ns = self.chunks[number - 1], self.chunks[0].message_start_time
        begin_s = (index.message_start_time - first_ns) / NS_PER_S
        end_s = (index.message_end_time - first_ns) / NS_PER_S
        return f"chunk {number} of {len(self.chunks)}, {begin_s:.2f} to {end_s:.2f} s"

    def require_plausible(self) -> "Layout":
        """Return this layout. Raises `ValueError` if its decompressed size exceeds the limits."""
        sizes = [chunk.uncompressed_size for chunk in self.chunks]
        if sum(sizes) > MOST_RATIO * self.size or max(sizes, default=0) > MOST_CHUNK:
            raise ValueError(
                f"{self.size / 1e6:.1f} MB would become {sum(sizes) / 1e6:.0f} MB, which exceeds the limit"
            )
        return self


def summary_layout(stream: IO[bytes]) -> Layout:
    """Read the summary, the index of all chunks. Raises one of `DAMAGE`."""
    _require_magic(stream)
    tail = FOOTER.size + len(MAGIC)
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(size - tail, 0))
    footer = stream.read()
    if footer[-len(MAGIC) :] != MAGIC or len(footer) != tail:
        raise ValueError("it is truncated")
    opcode, _, begin, _, checksum = FOOTER.unpack_from(footer)
    if opcode != Opcode.FOOTER or not len(MAGIC) + DATA_END.size <= begin <= size - tail:
        raise ValueError("the end of the file has no summary")
    stream.seek(begin)
    data = stream.read()
    # over everything except the checksum itself and the bytes after it
    if checksum and zlib.crc32(data[: -len(MAGIC) - 4]) != checksum:
        raise ValueError("its summary: the checksum differs")
    layout = Layout(size, begin)
    for record in StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Channel):
            layout.add_channel(record)
        elif isinstance(record, ChunkIndex):
            layout.chunks.append(record)
    return layout.require_plausible()


def scanned_layout(stream: IO[bytes]) -> Layout:
    """Find the chunks of a recording without a summary, record by record, up to the last complete one.

    The channels become known only as `chunk_messages` reads the chunks. Raises one of `DAMAGE`.
    """
    _require_magic(stream)
    layout, at = Layout(stream.seek(0, io.SEEK_END)), len(MAGIC)
    while at + RECORD.size <= layout.size:
        stream.seek(at)
        opcode, length = RECORD.unpack(stream.read(RECORD.size))
        if at + RECORD.size + length > layout.size or opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK and length > _CHUNK_HEAD.size:
            layout.chunks.append(_found_chunk(stream, at, RECORD.size + length))
        at += RECORD.size + length
    return layout.require_plausible()


def _require_magic(stream: IO[bytes]) -> None:
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("its start is not that of an MCAP file")


def _found_chunk(stream: IO[bytes], begin: int, length: int) -> ChunkIndex:
    first_ns, last_ns, size, _, name_length = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))
    return ChunkIndex(
        chunk_start_offset=begin,
        chunk_length=length,
        message_start_time=first_ns,
        message_end_time=last_ns,
        uncompressed_size=size,
        compressed_size=length,
        compression=stream.read(min(name_length, 8)).decode(errors="replace"),
        message_index_offsets={},
        message_index_length=0,
    )


def chunk_messages(stream: IO[bytes], layout: Layout, number: int) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield (channel, sequence, date in ns, data) of a chunk's messages; add its channels to the layout.

    number: of the chunk, from 1. Raises one of `DAMAGE`.
    """
    data = read_chunk(stream, layout, number)
    at = 0
    while at < len(data):
        opcode, length = RECORD.unpack_from(data, at)
        begin, at = at + RECORD.size, at + RECORD.size + length
        if at > len(data):
            raise ValueError(f"{layout.where(number)}: a message exceeds its chunk")
        if opcode == Opcode.CHANNEL:
            layout.add_channel(Channel.read(ReadDataStream(io.BytesIO(data[begin:at]))))
        if opcode == Opcode.MESSAGE:
            # the publish time is the message's own; the log time determines its place in the file
            channel, sequence, _, time_ns = _MESSAGE.unpack_from(data[begin:at])
            if time_ns > LAST_NS:
                raise ValueError(f"{layout.where(number)}: a message's time is beyond 64 bits")
            yield channel, sequence, time_ns, bytes(data[begin + _MESSAGE.size : at])


def read_chunk(stream: IO[bytes], layout: Layout, number: int) -> memoryview:
    """Read and decompress a chunk, and verify its checksum. Raises `ValueError` naming the chunk."""
    index, where = layout.chunks[number - 1], layout.where(number)
    if index.chunk_length > MOST_RATIO * MOST_CHUNK:
        raise ValueError(f"{where}: exceeds the chunk size limit")
    stream.seek(index.chunk_start_offset)
    try:
        record = next(
            StreamReader(io.BytesIO(stream.read(index.chunk_length)), True, emit_chunks=True).records
        )
    except (McapError, ValueError, struct.error, StopIteration) as error:
        raise ValueError(f"{where}: cannot be read") from error
    if not isinstance(record, Chunk) or record.uncompressed_size != index.uncompressed_size:
        raise ValueError(f"{where}: differs from the summary")
    data = _unpacked(record)
    if len(data) != record.uncompressed_size:
        raise ValueError(f"{where}: {len(data)} bytes instead of {record.uncompressed_size}")
    if record.uncompressed_crc and zlib.crc32(data) != record.uncompressed_crc:
        raise ValueError(f"{where}: the checksum differs")
    return memoryview(data)


def _unpacked(chunk: Chunk) -> bytes:
    """Decompress a chunk, up to one byte more than its stated size."""
    most = chunk.uncompressed_size + 1
    if chunk.compression == "zstd":
        unpack = zstandard.ZstdDecompressor(max_window_size=MOST_CHUNK)
        return unpack.stream_reader(chunk.data).read(most)
    if chunk.compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    if chunk.compression:
        raise ValueError(f"unknown compression '{chunk.compression[:20]}'")
    return chunk.data
