"""`rig benchmark faults --full`: every fault, alone and with another, at random moments of every stage.

Lifts are done in parts of ten, each a trial on a bench of its own; the recordings of a part are looked at and
then left out, and what came of its faults is kept. A part that was broken off begins anew.
"""

import random
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.types import Frame, Image
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.readme import markdown_table
from rig.benchmark.wire.fault_cases import CASES, FaultCase, both
from rig.benchmark.wire.faults import FaultResult, run_faults
from rig.benchmark.wire.moments import Moment, Stage, random_moment
from rig.benchmark.wire.tries import tried
from rig.config import BenchConfig, load_bench
from rig.experiments.process_pool import run_tasks
from rig.report.film import HEIGHT_PX
from rig.report.film_file import save_film
from rig.sessions.codec import Codec, json_line
from rig.sessions.files import append_line
from rig.sessions.layout import recording_file
from rig.sessions.reading import recorded_frames
from rig.sessions.rows import read_rows

PART = 10
TWO_AT_ONCE = 1 / 3
"""Share of the lifts in which two faults come at once."""
FILE, PART_FOLDER, FILM = "faults.jsonl", "part", "worst.avi"
FPS = 30.0
Planned = tuple[FaultCase, Moment]


@dataclass(frozen=True, slots=True)
class FaultRow:
    """What came of a fault. seen_s: from it to the rig's stop. still_s: from it to standstill of the tool.

    outcomes: of the attempts that it ended; none where the lift was over before it was missed.
    """

    number: int
    fault: str
    stage: Stage
    seen_s: float | None
    still_s: float
    dropped: bool
    outcomes: tuple[str, ...]
    recovered: bool
    passed: bool


CODEC: Codec[FaultRow] = Codec(FaultRow)


def plan_campaign(seed: int, count: int) -> list[Planned]:
    """Draw the lifts that so many faults take: each in each stage as often, a third with another device's."""
    rng = random.Random(seed)  # noqa: S311 - moments, no secrets
    plan: list[Planned] = []
    while count_faults(plan) < count:
        cells = [(case, stage) for case in CASES for stage in Stage]
        rng.shuffle(cells)
        plan += [(_maybe_two(case, rng), random_moment(stage, rng)) for case, stage in cells]
    while count_faults(plan[:-1]) >= count:
        plan.pop()
    return plan


def count_faults(plan: Sequence[Planned]) -> int:
    """Return how many faults a plan has; two at once are two."""
    return sum(case.faults for case, _ in plan)


def _maybe_two(case: FaultCase, rng: random.Random) -> FaultCase:
    others = [other for other in CASES if other.name.partition(":")[0] != case.name.partition(":")[0]]
    return both(case, rng.choice(others)) if rng.random() < TWO_AT_ONCE else case


def run_campaign(
    folder: Path,
    plan: Sequence[Planned],
    resume: bool = False,
    progress: Callable[[FaultRow], None] = lambda row: None,
    bench: BenchConfig | None = None,
    jobs: int = 1,
) -> list[FaultRow]:
    """Run the faults that are not in the folder yet; return what came of all, in the plan's order.

    bench: the bench behind wires, by default `wire`. jobs: benches side by side, each in real time. Raises
    `InputError` for a folder that has faults and is not to be resumed, or has those of another plan, and what
    `run_faults` raises.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = {row.number: row for row in read_rows(folder / FILE, CODEC)}
    if rows and not resume:
        raise InputError(f"{folder}: has {len(rows)} faults; go on with --resume, or give another folder")
    for number, row in rows.items():
        if number > len(plan) or row.fault != plan[number - 1][0].name:
            raise InputError(
                f"{folder}: its fault {number} is '{row.fault}', which is another plan's; resume with the "
                "--seed and --count that it was begun with, or give another folder"
            )
    wire = bench or load_bench("wire")
    work = partial(_run_part, folder, wire)
    for part, new in run_tasks(work, _parts_left(plan, rows), jobs):
        _film_if_worst(folder, part, list(rows.values()), new, wire)
        shutil.rmtree(folder / part.folder)
        for row in new:
            append_line(folder / FILE, json_line(row))
            progress(row)
        rows |= {row.number: row for row in new}
    return [rows[number] for number in range(1, len(plan) + 1)]


@dataclass(frozen=True, slots=True)
class _Part:
    """Faults that are next to each other in the plan. first: the number of the first one, from 1."""

    first: int
    planned: tuple[Planned, ...]

    @property
    def folder(self) -> str:
        """Of its lifts."""
        return f"{PART_FOLDER}_{self.first}"


def _parts_left(plan: Sequence[Planned], rows: Mapping[int, FaultRow]) -> list[_Part]:
    """Return the parts of the plan that have faults without a row, with these alone."""
    parts: list[_Part] = []
    for number, planned in enumerate(plan, start=1):
        if number in rows:
            continue
        if parts and (last := parts[-1]).first + len(last.planned) == number and len(last.planned) < PART:
            parts[-1] = _Part(last.first, (*last.planned, planned))
        else:
            parts.append(_Part(number, (planned,)))
    return parts


def _run_part(folder: Path, bench: BenchConfig, part: _Part) -> list[FaultRow]:
    """Run a part, and again where no lift runs any more although every device is mended."""
    results = tried(partial(_run_once, folder / part.folder, bench, part))
    return [row_of(number, result) for number, result in enumerate(results, start=part.first)]


def _run_once(folder: Path, bench: BenchConfig, part: _Part) -> list[FaultResult]:
    shutil.rmtree(folder, ignore_errors=True)
    return run_faults(folder, part.planned, bench=bench)


def row_of(number: int, result: FaultResult) -> FaultRow:
    """Return what is kept of a result."""
    return FaultRow(
        number=number,
        fault=result.case.name,
        stage=result.stage or result.moment.stage,
        seen_s=result.detected_s,
        still_s=max(0, result.still_ns - result.injected_ns) / NS_PER_S,
        dropped=result.dropped,
        outcomes=tuple(result.faults),
        recovered=result.recovered,
        passed=result.passed,
    )


def judge_campaign(rows: Sequence[FaultRow]) -> list[Measured]:
    """Return the limits of a campaign; that finished lifts are whole, each part has seen to itself."""
    return [
        at_most("objects dropped", sum(row.dropped for row in rows), 0),
        at_most("lifts after a fault that did not run", sum(not row.recovered for row in rows), 0),
        at_most("faults not seen, not named or not made safe", sum(not row.passed for row in rows), 0),
    ]


CAMPAIGN_COLUMNS = (
    "fault", "lifts", "with another", "seen, s: median", "longest", "stood, s: longest", "not missed",
    "dropped", "next lift", "passed",
)  # fmt: skip


def campaign_rows(rows: Sequence[FaultRow]) -> list[list[str]]:
    """Return a row of the table for each fault, those with another under the first one's name."""
    return [
        _table_row(case.name, [r for r in rows if r.fault.split(" + ")[0] == case.name]) for case in CASES
    ]


def campaign_section(head: str, rows: Sequence[FaultRow]) -> str:
    """Return the table in Markdown, under a sentence of what was run and over its limits."""
    table = markdown_table(CAMPAIGN_COLUMNS, campaign_rows(rows))
    return "\n".join([f"{head}.", "", table, "", *(limit.line for limit in judge_campaign(rows))])


def _table_row(name: str, rows: Sequence[FaultRow]) -> list[str]:
    seen = [row.seen_s for row in rows if row.seen_s is not None]
    return [
        name,
        str(len(rows)),
        str(sum(" + " in row.fault for row in rows)),
        f"{np.median(seen):.2f}" if seen else "-",
        f"{max(seen):.2f}" if seen else "-",
        f"{max((row.still_s for row in rows), default=0.0):.2f}",
        str(sum(not row.outcomes for row in rows)),
        str(sum(row.dropped for row in rows)),
        f"{sum(row.recovered for row in rows)} of {len(rows)}",
        f"{sum(row.passed for row in rows)} of {len(rows)}",
    ]


def worst(rows: Sequence[FaultRow]) -> FaultRow | None:
    """Return the fault after which it took longest until the tool stood; one that failed before all."""
    seen = [row for row in rows if row.outcomes]
    return max(seen, key=lambda row: (not row.passed, row.still_s), default=None)


def _film_if_worst(
    folder: Path, part: _Part, rows: list[FaultRow], new: list[FaultRow], bench: BenchConfig
) -> None:
    found = worst([*rows, *new])
    if found is None or found not in new:
        return
    recording = folder / part.folder / recording_file(1 + found.number - part.first, 0)
    serials = [*(tactile.serial for tactile in bench.tactile), bench.camera.serial]
    streams = [list(recorded_frames(recording, serial)) for serial in serials]
    if all(streams):
        save_film(folder / FILM, _pictures(streams, f"SIMULATED {found.fault}, {found.stage}"), FPS)


def _pictures(streams: Sequence[Sequence[Frame]], title: str) -> Iterator[Image]:
    """Show what each source saw last, side by side, from the first frame to the end."""
    begin = max(stream[0].time_ns for stream in streams)
    end = max(stream[-1].time_ns for stream in streams)
    for time_ns in range(begin, end, round(NS_PER_S / FPS)):
        panels = [_panel(next(f for f in reversed(s) if f.time_ns <= time_ns).image) for s in streams]
        picture = np.ascontiguousarray(np.concatenate(panels, axis=1))
        text = f"{title}, {(time_ns - begin) / NS_PER_S:.1f} s"
        cv2.putText(picture, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        yield picture


def _panel(image: Image) -> Image:
    width = round(image.shape[1] * HEIGHT_PX / image.shape[0]) // 2 * 2
    return np.asarray(cv2.resize(image, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA), np.uint8)
