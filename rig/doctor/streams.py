"""Check all fingertips and cameras simultaneously, because a shared USB bus fails only then."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import DeviceError, InputError, RigError
from drivers.images import encode_png
from drivers.interfaces import FrameSource
from drivers.tally import FrameTally
from drivers.types import Frame
from rig.bench.findings import Finding, Severity, assess, assess_picture, read_source
from rig.doctor.finding import percentiles_ms, percentiles_text

RATE_SHARE = 0.97
"""Lowest accepted fraction of the requested frame rate."""
FRAME_S = 0.5
OLD_MS = 50.0
"""Highest accepted 95th percentile of a frame's age when it is read."""


@dataclass(frozen=True, slots=True)
class SourceRecord:
    """Measurement of one source: times of all frames (ns), their ages when read (s), and the last frame.

    missed: number of lost frames. counted: the driver's counters (frozen, green, reopened ...).
    """

    times_ns: list[int]
    ages_s: list[float]
    last: Frame
    missed: int
    counted: dict[str, int]


def look_at_streams(
    sources: Sequence[FrameSource],
    clock: Clock,
    sizes_px: Mapping[str, tuple[int, int]],
    duration_s: float,
    snapshot: Path | None,
) -> list[Finding]:
    """Open all sources one after the other, then read them simultaneously for `duration_s`.

    sizes_px: width and height in the bench file, by serial. snapshot: folder in which the last frame of each
    source is saved as SERIAL.png; None saves none.
    """
    findings: list[Finding] = []
    opened = []
    for source in sources:
        if read_source(source, clock, findings) is not None:
            opened.append(source)
    with ThreadPoolExecutor(max(len(opened), 1)) as pool:
        looks = list(pool.map(lambda source: _watch(source, clock, duration_s), opened))
    for source, stream in zip(opened, looks, strict=True):
        if isinstance(stream, RigError):
            findings.append(Finding(source.serial, "frames", Severity.FAILURE, str(stream)))
            continue
        findings += [
            _rate(source, stream),
            _age(source, stream),
            assess_picture(stream.last, sizes_px[source.serial]),
        ]
        findings += _counter_findings(source, stream.counted)
        if snapshot is not None:
            findings.append(_save(snapshot, stream.last))
    return findings


def _watch(source: FrameSource, clock: Clock, duration_s: float) -> SourceRecord | RigError:
    times, ages, tally = [], [], FrameTally()
    try:
        last = source.newest_frame(1.0)
        before = source.counters()
        end = clock.now_ns() + to_ns(duration_s)
        while clock.now_ns() < end:
            last = source.next_frame(FRAME_S)
            times.append(last.time_ns)
            ages.append((clock.now_ns() - last.time_ns) / NS_PER_S)
            tally.add(last)
    except RigError as error:
        return error
    if len(times) < 2:
        return DeviceError(f"{source.serial}: too few frames ({len(times)} in {duration_s:g} s)")
    counted = {name: count - before.get(name, 0) for name, count in source.counters().items()}
    return SourceRecord(times, ages, last, tally.dropped, counted)


def _rate(source: FrameSource, stream: SourceRecord) -> Finding:
    gaps = np.diff(stream.times_ns) / NS_PER_S
    rate_hz = len(gaps) / float(gaps.sum())
    interval = percentiles_ms(gaps)
    good = rate_hz >= RATE_SHARE * source.rate_hz and stream.missed == 0
    seen = (
        f"{rate_hz:.2f} of {source.rate_hz:g} a second, {stream.missed} missed; "
        f"{percentiles_text(interval)} apart"
    )
    todo = "give each camera its own USB controller (a hub does not help), or request a lower rate"
    figures = {"rate_hz": rate_hz, "wanted_hz": source.rate_hz, "missed": stream.missed, **interval}
    return assess(source.serial, "frames", good, seen, todo, figures)


def _age(source: FrameSource, stream: SourceRecord) -> Finding:
    figures = percentiles_ms(stream.ages_s)
    todo = "end other loads on this computer; older frames blur the comparison"
    seen = f"read {percentiles_text(figures)} after capture"
    return assess(source.serial, "latency", figures["p95_ms"] <= OLD_MS, seen, todo, figures)


def _counter_findings(source: FrameSource, counted: dict[str, int]) -> list[Finding]:
    if not counted:
        return []
    amiss = {name: count for name, count in counted.items() if count and name not in ("frames", "warm_up")}
    seen = ", ".join(f"{count} {name}" for name, count in amiss.items()) or "no problems counted"
    todo = "check the cable and the plug; replug the sensor"
    return [assess(source.serial, "counters", not amiss, seen, todo, counted)]


def _save(folder: Path, frame: Frame) -> Finding:
    path = folder / f"{frame.serial}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encode_png(frame.image))
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); give another --snapshot"
        ) from error
    return Finding(frame.serial, "snapshot", Severity.NOTE, str(path))
