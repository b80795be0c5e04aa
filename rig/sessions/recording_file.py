"""The messages of a recording (MCAP); each chunk is verified with its checksum before it is used.

A reader finds the chunks through the summary, which has a checksum as well, so what is returned is what was
written. A damaged chunk is an error, or, if the caller asks for it, a gap: it is named, and the messages
before and after it are used. An unfinished recording has no summary; it is read chunk by chunk up to its last
complete one.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from drivers.clock import to_ns
from drivers.errors import RigError, SessionError
from drivers.formats import reason
from protocols.observer import Phase
from rig.sessions.files import is_unfinished
from rig.sessions.recording_chunks import (
    DAMAGE,
    DATA_END,
    LAST_NS,
    MOST_CHUNK,
    Layout,
    chunk_messages,
    read_chunk,
    scanned_layout,
    summary_layout,
)

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
        if name in self._times_ns or not in_time or not self._follows(name):
            raise SessionError(f"{self._path}: the recording is damaged (phase {name} out of order)")
        self._times_ns[name] = time_ns

    def complete(self) -> dict[str, int]:
        """Return all phases, ns. Raises `SessionError` if one is missing from a finished recording."""
        missing = [phase.value for phase in Phase if phase not in self._times_ns]
        if missing and not is_unfinished(self._path):
            raise SessionError(f"{self._path}: is not a complete lift: phase {', '.join(missing)} is missing")
        return self._times_ns

    def _follows(self, name: str) -> bool:
        left = list(Phase)[len(self._times_ns) :]
        return name in (left if self._gaps else left[:1])


def recorded_messages(
    path: Path, *topics: str, gaps: Gaps | None = None, dated: bool = False
) -> Iterator[RecordedMessage]:
    """Yield (topic, time_ns, sequence, data) in the order of writing, of all or some topics.

    time_ns: by the bench's clock; if `dated`, the date stored in the file. gaps: list to which damaged parts
    are added; they are then skipped. Raises `SessionError` for a missing recording, and without `gaps` at the
    first damaged chunk.
    """
    try:
        with path.open("rb") as stream:
            yield from _messages(stream, path, set(topics), gaps, dated)
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except DAMAGE as error:
        raise _damaged(path, [reason(error)]) from error


def recording_gaps(path: Path) -> Gaps:
    """Return the damaged parts of a recording, checking every byte; empty if it is undamaged.

    If the file has no checksum of all data, as in the first versions, chunks and summary are checked, which
    covers everything that is ever read. Raises `SessionError` if it is missing or not a recording.
    """
    try:
        with path.open("rb") as stream:
            gaps: Gaps = []
            layout = _layout(stream, path, gaps)
            flaw = _data_flaw(stream, layout)
            if flaw is not None:
                gaps += _damaged_chunks(stream, layout) or ([flaw] if flaw else [])
            return gaps
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except DAMAGE as error:
        raise _damaged(path, [reason(error)]) from error


def check_recording(path: Path) -> None:
    """Raise `SessionError` if any byte of a recording is damaged, see `recording_gaps`."""
    if gaps := recording_gaps(path):
        raise _damaged(path, gaps)


def gaps_text(path: Path, gaps: Gaps, error: RigError | None = None) -> str:
    """Return one line that names a recording's gaps, and whether the rest was used.

    error: why the rest could not be used; None if it was.
    """
    rest = "the data before and after were used" if error is None else f"the rest is not enough: {error}"
    return f"{_damaged(path, gaps)}; {rest}"


def recording_values(path: Path) -> dict[str, str]:
    """Return a recording's metadata by name, see `RecordingAbout`. Raises `SessionError`."""
    try:
        with path.open("rb") as stream:
            records = StreamReader(stream, emit_chunks=True, record_size_limit=MOST_CHUNK).records
            for _, record in zip(range(4), records, strict=False):
                if isinstance(record, Metadata):
                    return dict(record.metadata)
    except DAMAGE as error:
        raise _damaged(path, [reason(error)]) from error
    raise SessionError(f"{path}: the recording does not state which lift it is of")


def _damaged(path: Path, gaps: Gaps) -> SessionError:
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
                    time_ns = date if dated else _bench_time(date, layout.offsets_ns[channel])
                    yield topic, time_ns, sequence, data
        except DAMAGE as error:
            if gaps is None:
                raise
            gaps.append(reason(error))


def _bench_time(time_ns: int, offset_ns: int) -> int:
    if not 0 <= time_ns - offset_ns <= LAST_NS:
        raise ValueError("a message's time is before its clock's beginning")
    return time_ns - offset_ns


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
    fits = _checksum(stream, layout.summary_begin - DATA_END.size) == checksum
    return None if fits else "between its chunks: the checksum differs"


def _damaged_chunks(stream: IO[bytes], layout: Layout) -> Gaps:
    found: Gaps = []
    for number in range(1, len(layout.chunks) + 1):
        try:
            read_chunk(stream, layout, number)
        except DAMAGE as error:
            found.append(reason(error))
    return found


def _checksum(stream: IO[bytes], size: int) -> int:
    checksum = 0
    while size > 0:
        portion = stream.read(min(size, _PORTION))
        if not portion:
            raise EOFError("it is truncated")
        checksum, size = zlib.crc32(portion, checksum), size - len(portion)
    return checksum
