"""The messages of a recording (MCAP); each chunk is verified with its checksum before it is used.

A reader finds the chunks through the summary, which has a checksum as well, so what is returned is what was
written. A damaged chunk is an error, or, if the caller asks for it, a gap: it is named, and the messages
before and after it are used. An unfinished recording has no summary; it is read chunk by chunk up to its last
complete one. A chunk is decompressed only up to its permitted size. The library's own readers decompress
without a limit, and ignore the checksum of a summary. File format: https://mcap.dev/spec.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Metadata
from mcap.stream_reader import StreamReader

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import RigError, SessionError
from drivers.formats import reason
from protocols.observer import Phase
from rig.sessions.about import CLOCK_OFFSET
from rig.sessions.files import MAGIC, is_unfinished

MOST_CHUNK = 64_000_000
"""Size limit of a decompressed chunk, bytes; the recorder's chunks have an eighth of a megabyte plus a
picture."""
MOST_RATIO = 20
"""Largest decompression ratio of a recording; its pictures are compressed already."""
LAST_NS = 2**63 - 1
"""Largest time that fits in a signed 64-bit integer."""
_LONGEST_S = 3600.0
"""Longest duration of a valid lift."""
MOST_NAMED = 3
"""Most gaps that an error message lists."""
_PORTION = 1 << 20
"""Most bytes read at once."""

RecordedMessage = tuple[str, int, int, bytes]
"""Topic, time in ns, sequence, data."""
Gaps = list[str]
"""Unreadable parts of a recording: which chunk, its time since the recording's start, and why."""
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
    data = _decompress(record)
    if len(data) != record.uncompressed_size:
        raise ValueError(f"{where}: {len(data)} bytes instead of {record.uncompressed_size}")
    if record.uncompressed_crc and zlib.crc32(data) != record.uncompressed_crc:
        raise ValueError(f"{where}: the checksum differs")
    return memoryview(data)


def _decompress(chunk: Chunk) -> bytes:
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


class PhaseTimes:
    """Collects the phases of a recording, which must be in order.

    gaps: of the recording, if they are skipped; a phase inside a gap may then be missing.
    """

    def __init__(self, path: Path, gaps: Gaps | None = None) -> None:
        self._path = path
        self._gaps = gaps
        self._times_ns: dict[str, int] = {}

    def add(self, name: str, time_ns: int) -> None:
        """Add a phase. Raises `SessionError` if it does not follow those so far."""
        begun = list(self._times_ns.values()) or [time_ns]
        in_time = begun[-1] <= time_ns <= begun[0] + to_ns(_LONGEST_S)
        left = list(Phase)[len(self._times_ns) :]
        follows = name in (left if self._gaps else left[:1])
        if name in self._times_ns or not in_time or not follows:
            raise SessionError(f"{self._path}: the recording is damaged (phase {name} out of order)")
        self._times_ns[name] = time_ns

    def complete(self) -> dict[str, int]:
        """Return all phases, ns. Raises `SessionError` if one is missing from a finished recording."""
        missing = [phase.value for phase in Phase if phase not in self._times_ns]
        if missing and not is_unfinished(self._path):
            raise SessionError(f"{self._path}: is not a complete lift: phase {', '.join(missing)} is missing")
        return self._times_ns


def recorded_messages(
    path: Path, *topics: str, gaps: Gaps | None = None, dated: bool = False
) -> Iterator[RecordedMessage]:
    """Yield (topic, time_ns, sequence, data) in the order of writing, of all or some topics.

    time_ns: by the bench's clock; if `dated`, the date stored in the file. gaps: list to which damaged parts
    are added; they are then skipped. Raises `SessionError` for a missing recording, and without `gaps` at the
    first damaged chunk.
    """
    with _open_recording(path) as stream:
        yield from _messages(stream, path, set(topics), gaps, dated)


def recording_gaps(path: Path) -> Gaps:
    """Return the damaged parts of a recording, checking every byte; empty if it is undamaged.

    If the file has no checksum of all data, as in the first versions, chunks and summary are checked, which
    covers everything that is ever read. Raises `SessionError` if it is missing or not a recording.
    """
    with _open_recording(path) as stream:
        gaps: Gaps = []
        layout = _layout(stream, path, gaps)
        flaw = _data_flaw(stream, layout)
        before = len(gaps)
        for number in range(1, len(layout.chunks) + 1) if flaw is not None else ():
            try:
                read_chunk(stream, layout, number)
            except DAMAGE as error:
                gaps.append(reason(error))
        return [*gaps, flaw] if flaw and len(gaps) == before else gaps


def check_recording(path: Path) -> None:
    """Raise `SessionError` if any byte of a recording is damaged, see `recording_gaps`."""
    if gaps := recording_gaps(path):
        raise _damage_error(path, gaps)


def gaps_text(path: Path, gaps: Gaps, error: RigError | None = None) -> str:
    """Return one line that names a recording's gaps, and whether the rest was used.

    error: why the rest could not be used; None if it was.
    """
    rest = "the data before and after were used" if error is None else f"the rest is not enough: {error}"
    return f"{_damage_error(path, gaps)}; {rest}"


def recording_values(path: Path) -> dict[str, str]:
    """Return a recording's metadata by name, see `RecordingAbout`. Raises `SessionError`."""
    with _open_recording(path) as stream:
        records = StreamReader(stream, emit_chunks=True, record_size_limit=MOST_CHUNK).records
        for _, record in zip(range(4), records, strict=False):
            if isinstance(record, Metadata):
                return dict(record.metadata)
    raise SessionError(f"{path}: the recording does not state which lift it is of")


@contextmanager
def _open_recording(path: Path) -> Iterator[IO[bytes]]:
    """Open a recording. Raises `SessionError` if it is missing, and for damage found in the block."""
    try:
        with path.open("rb") as stream:
            yield stream
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except DAMAGE as error:
        raise _damage_error(path, [reason(error)]) from error


def _damage_error(path: Path, gaps: Gaps) -> SessionError:
    more = f"; and {len(gaps) - MOST_NAMED} more" if len(gaps) > MOST_NAMED else ""
    return SessionError(f"{path}: the recording is damaged ({'; '.join(gaps[:MOST_NAMED])}{more})")


def _layout(stream: IO[bytes], path: Path, gaps: Gaps | None) -> Layout:
    """Find the chunks; without a readable summary, scan for them if unfinished or if gaps are allowed."""
    try:
        return summary_layout(stream)
    except DAMAGE as error:
        if is_unfinished(path):
            return scanned_layout(stream)
        if gaps is None:
            raise
        layout = scanned_layout(stream)
        gaps.append(reason(error))
        return layout


def _messages(
    stream: IO[bytes], path: Path, topics: set[str], gaps: Gaps | None, dated: bool
) -> Iterator[RecordedMessage]:
    layout = _layout(stream, path, gaps)
    for number, index in enumerate(layout.chunks, start=1):
        inside = {layout.topics.get(channel, "") for channel in index.message_index_offsets}
        if inside and topics and topics.isdisjoint(inside):
            continue
        try:
            for channel, sequence, date, data in chunk_messages(stream, layout, number):
                topic = layout.topics.get(channel)
                if topic is not None and (not topics or topic in topics):
                    time_ns = date if dated else date - layout.offsets_ns[channel]
                    if not 0 <= time_ns <= LAST_NS:
                        raise ValueError("a message's time is before its clock's beginning")
                    yield topic, time_ns, sequence, data
        except DAMAGE as error:
            if gaps is None:
                raise
            gaps.append(reason(error))


def _data_flaw(stream: IO[bytes], layout: Layout) -> str | None:
    """Return None if the checksum of all data matches; otherwise the flaw, or "" if there is no checksum."""
    if layout.summary_begin is None:
        return ""
    stream.seek(layout.summary_begin - DATA_END.size)
    opcode, length, checksum = DATA_END.unpack(stream.read(DATA_END.size))
    if (opcode, length) != (Opcode.DATA_END, 4):
        return "its data have no end"
    stream.seek(0)
    if not checksum:
        return ""
    found, size = 0, layout.summary_begin - DATA_END.size
    while size > 0:
        portion = stream.read(min(size, _PORTION))
        if not portion:
            raise EOFError("it is truncated")
        found, size = zlib.crc32(portion, found), size - len(portion)
    return None if found == checksum else "between its chunks: the checksum differs"
