"""Recordings replayed, and written again: with other phases, in smaller chunks, with damaged ones."""

import io
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.sessions.files import RECORDINGS, is_unfinished
from rig.sessions.manifest import TrialManifest, begun_on
from rig.sessions.recording_file import summary_layout
from rig.sessions.rows import read_finished_lifts

Edit = Callable[[str], list[tuple[str, int]]]
"""Returns the phases to write for one, by name, each with how much later, ns."""
Change = Callable[[int, bytes], bytes]
"""Returns other data for a message, by its number, from 0, and its data."""


def unfinished_recordings(folder: Path) -> list[Path]:
    """Return the unfinished and interrupted recordings of a session, by name."""
    return sorted(path for path in (folder / RECORDINGS).glob("*.mcap") if is_unfinished(path))


def require_identical_replay(session: Path) -> None:
    """Replay a session's lifts; fail unless every value is the stored one."""
    for row, again in zip(
        read_finished_lifts(session), run_replay(stored_trial(session), jobs=1).rows, strict=True
    ):
        pairs = {
            field.name: (getattr(row, field.name), getattr(again, field.name))
            for field in fields(row)
            if field.compare
        }
        differing = {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
        assert not differing, f"{session}: lift {row.number}"


def written_again(
    recording: Path,
    edit: Edit = lambda name: [(name, 0)],
    chunk_bytes: int = 1_000_000,
    late: tuple[str, int, int] = ("", 0, 0),
    changed: tuple[str, Change] = ("", lambda number, data: data),
) -> None:
    """Write a recording again, with other phases or in other chunks.

    late: topic and number, from 0, of a message that gets a later time, and by how much, ns. changed: topic
    whose messages get other data.
    """
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.NONE, enable_data_crcs=True)
    writer.start()
    channels: dict[int, int] = {}
    seen: Counter[str] = Counter()
    with recording.open("rb") as source:
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=False):
            if channel.id not in channels:
                kept = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kept, dict(channel.metadata)
                )
            number = seen[channel.topic]
            seen[channel.topic] += 1
            data = changed[1](number, message.data) if channel.topic == changed[0] else message.data
            messages = [(data, late[2] if (channel.topic, number) == late[:2] else 0)]
            if channel.topic == "/phase":
                phases = edit(json.loads(message.data)["phase"])
                messages = [(json.dumps({"phase": name}).encode(), later_ns) for name, later_ns in phases]
            for data, later_ns in messages:
                date = message.publish_time + later_ns
                writer.add_message(channels[channel.id], date, data, date, message.sequence)
    writer.finish()
    recording.write_bytes(stream.getvalue())


def damage_chunks(recording: Path, *numbers: int) -> None:
    """Flip a bit in the middle of chunks, numbered from 1."""
    data = bytearray(recording.read_bytes())
    with recording.open("rb") as stream:
        chunks = summary_layout(stream).chunks
    for number in numbers:
        index = chunks[number - 1]
        data[index.chunk_start_offset + index.chunk_length // 2] ^= 1
    recording.write_bytes(data)


def chunk_with(recording: Path, topic: str, number: int = 0) -> int:
    """Return which chunk, from 1, holds a topic: the first such chunk, or that after `number` others."""
    with recording.open("rb") as stream:
        layout = summary_layout(stream)
    holding = [
        place
        for place, index in enumerate(layout.chunks, start=1)
        if topic in {layout.topics[channel] for channel in index.message_index_offsets}
    ]
    return holding[number]


def trial_request(bench: BenchConfig | None = None, lifts: int = 3, seed: int = 0) -> TrialManifest:
    """The manifest of a new trial with t1, by default on the bench `fake`."""
    asked = begun_on(bench or load_bench("fake"), "trial", seed, ["t1"])
    return TrialManifest(
        **vars(asked), lifts_per_object=lifts, estimator="slip", window=1, skip=True, truth="edges"
    )
