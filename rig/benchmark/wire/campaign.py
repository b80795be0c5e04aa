"""`rig benchmark faults --full`: every fault, alone and with another, at random moments of every stage.

Lifts are done in parts of ten, each a trial on a bench of its own. The rows of a part are stored and its
recordings are deleted. A part that was interrupted is run again.
"""

import random
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.types import Frame, Image
from rig.benchmark.harness import Run
from rig.benchmark.wire.fault_cases import CASES, FaultCase, both
from rig.benchmark.wire.fault_lifts import FaultRow, Planned, run_faults
from rig.benchmark.wire.moments import Stage, random_moment, tried
from rig.config import BenchConfig
from rig.report.film import HEIGHT_PX
from rig.report.film_file import save_film
from rig.sessions.files import recording_file
from rig.sessions.reading import recorded_frames

PART = 10
TWO_AT_ONCE = 1 / 3
"""Share of the lifts in which two faults come at once."""
PART_FOLDER, FILM = "part", "worst.avi"
FPS = 30.0


def plan_campaign(seed: int, count: int) -> list[Planned]:
    """Draw the lifts of `count` faults: each in each stage equally often, a third with another device's."""
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


@dataclass(frozen=True, slots=True)
class _Part:
    """Lifts that are next to each other in the plan. first: the number of the first one, from 1."""

    first: int
    planned: Sequence[Planned]

    def __str__(self) -> str:
        return f"lifts {self.first} to {self.first + len(self.planned) - 1}"

    @property
    def folder(self) -> str:
        """Folder of its lifts, within that of the campaign."""
        return f"{PART_FOLDER}_{self.first}"


@dataclass(frozen=True, slots=True)
class PartRows:
    """The faults of a part."""

    rows: tuple[FaultRow, ...]


def run_campaign(run: Run, plan: Sequence[Planned], bench: BenchConfig) -> list[FaultRow]:
    """Run the parts that are not in the run's folder yet; return the rows of all, in the plan's order.

    run.jobs: benches side by side, each in real time. Raises `InputError` for a folder with faults of another
    plan, bench or seed, and what `Run.each` and `run_faults` raise.
    """
    folder, common = run.results_folder, f"bench '{bench.name}', seed {run.seed}, "
    parts = [_Part(i + 1, plan[i : i + PART]) for i in range(0, len(plan), PART)]
    stored = run.stored(PartRows, common)
    for part in parts:
        rows = stored[common + str(part)].rows if common + str(part) in stored else ()
        if rows and [row.fault for row in rows] != [case.name for case, _ in part.planned]:
            raise InputError(f"{folder}: its {part} have the faults of another version; give another folder")
    known = [row for of in stored.values() for row in of.rows]

    def finish(part: _Part, new: PartRows) -> str:
        last = worst([*known, *new.rows])
        if last in new.rows:
            _film(folder, part, last, bench)
        shutil.rmtree(folder / part.folder)
        known.extend(new.rows)
        return "\n  ".join([f"{part}:", *(row.line for row in new.rows)])

    work = partial(_run_part, folder, bench)
    done = run.each(work, parts, lambda part: common + str(part), PartRows, common=common, finish=finish)
    return [row for of in done for row in of.rows]


def _run_part(folder: Path, bench: BenchConfig, part: _Part) -> PartRows:
    """Run a part, and again if no lift runs any more although every device is mended."""

    def run_once() -> list[FaultRow]:
        shutil.rmtree(folder / part.folder, ignore_errors=True)
        return run_faults(folder / part.folder, part.planned, bench=bench)

    return PartRows(tuple(replace(row, number=part.first + row.number - 1) for row in tried(run_once)))


def worst(rows: Sequence[FaultRow]) -> FaultRow | None:
    """Return the fault with the longest time until the tool stood; a failed one comes before all others."""
    seen = [row for row in rows if row.outcomes]
    return max(seen, key=lambda row: (not row.passed, row.still_s), default=None)


def _film(folder: Path, part: _Part, row: FaultRow, bench: BenchConfig) -> None:
    recording = folder / part.folder / recording_file(1 + row.number - part.first, 0)
    serials = [*(tactile.serial for tactile in bench.tactile), bench.camera.serial]
    streams = [list(recorded_frames(recording, serial)) for serial in serials]
    if all(streams):
        save_film(folder / FILM, _pictures(streams, f"SIMULATED {row.fault}, {row.stage}"), FPS)


def _pictures(streams: Sequence[Sequence[Frame]], title: str) -> Iterator[Image]:
    """Yield the newest image of each source side by side, from the first frame to the end."""
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
