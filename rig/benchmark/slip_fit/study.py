"""`rig fit-slip`: fits the parameters of slip to clips and SIMULATED lifts with known angles."""

import math
import tempfile
import time
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from drivers.errors import InputError, unknown_name
from rig.benchmark.clips.augmented import clip_version
from rig.benchmark.clips.labelled import ClipVersion, read_clips
from rig.benchmark.harness import Report, Run, Study, column, option, table_of
from rig.benchmark.seeds import LiftCase
from rig.benchmark.slip_fit.cases import (
    Case,
    Kind,
    penalty,
    store_clip,
    store_lift,
    store_rendered,
)
from rig.config import BenchConfig
from rig.config.calibrations import load_calibrated_bench
from rig.experiments.process_pool import run_tasks
from rig.experiments.trial import resolve_objects
from rig.sessions.codec import Codec, json_line
from rig.sessions.files import append_line, drop_torn_line, write_json
from rig.sessions.rows import read_rows
from rig.tactile.slip.parameters import Values, shipped

STEP = 1.25
"""A parameter is changed by this factor; for a fraction, its odds are."""
FRACTIONS = frozenset(
    "good_score plain_fit least_richness least_count resting turning sticks anything correlation".split()
)
"""Parameters between 0 and 1, besides those whose name ends with "share"."""
COUNTS = frozenset("used check_frames iterations".split())
"""Parameters that are numbers of things: at least 1, and changed by 1 at least."""
SURE = 2.0
"""A gain must exceed this many of its standard errors: by chance one change of 40 does."""
INDEPENDENT = 12.0
"""Number of independent errors that the prior is compared with: those in a clip and its versions are
correlated. The prior of a parameter is log-normal around the shipped value, with a factor e as its width."""
PARTS = 4
"""A change is tried on one part of the cases first, and on the others only if it improves that part."""
TRIED = "tried.jsonl"
"""File of the folder: a line per change that was tried."""
LIFTS_OF_RENDERER = 4
FIRST_SEED, FIRST_LIFT = 900, 900
"""Seed of the lifts on the benches, and first lift of the second renderer. Benchmarks use lower numbers."""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of `rig fit-slip`."""

    folder: Annotated[Path, typer.Argument(help="Labelled clips, as of rig benchmark clips.")]
    groups: Annotated[
        Path | None, typer.Option("--groups", help="CSV with columns clip,group, as of rig benchmark clips.")
    ] = None
    group: Annotated[
        str | None, typer.Option("--group", help="Only the clips of this group. Default: all clips.")
    ] = None
    lifts: int = option(
        2,
        "SIMULATED lifts of each object on the bench hard; half as many on the bench fake, and "
        f"{LIFTS_OF_RENDERER} times as many of the second renderer.",
        min=1,
        max=20,
    )
    only: list[str] | None = option(
        None, "Only this parameter, or this group of parameters, as keyframes.richer or keyframes; repeat."
    )
    minutes: float | None = option(None, "Stop after this time. Default: when all were tried.", min=0.0)
    save: Annotated[
        Path | None, typer.Option("--save", help="File for the fitted parameters and their card.")
    ] = None


@dataclass(frozen=True, slots=True)
class Tried:
    """A change of one parameter: its gain of mean log likelihood, the standard error, and the decision.

    complete: whether it was tried on all cases.
    """

    parameter: str
    before: float
    value: float
    gain: float
    error: float
    complete: bool
    adopted: bool


@dataclass(frozen=True, slots=True)
class DataRow:
    """Mean negative log likelihood of one kind of cases."""

    data: str = column("data")
    cases: int = column("cases")
    before: float = column("before", ".3f", "mean negative log likelihood")
    fitted: float = column("fitted", ".3f", "the same with the fitted parameters")


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """A parameter that was tried."""

    parameter: str = column("parameter")
    before: float = column("before", ".4g")
    fitted: float = column("fitted", ".4g")
    smaller: float | None = column("gain if smaller", "+.4f", "of mean log likelihood, by the first step")
    larger: float | None = column("gain if larger", "+.4f")
    error: float | None = column("standard error", ".4f")


def measure(options: FitOptions, run: Run) -> Report:
    """Fit the parameters of slip by maximum likelihood, to clips and SIMULATED lifts with known angles.

    The cases are the clips in all versions of `rig benchmark clips --augment`, lifts of the benches fake and
    hard, and lifts of the second renderer, with seeds that no benchmark uses. In the likelihood, errors are
    normal with the variances of answer and ground truth, with a few outliers; a refused angle counts as an
    outlier. Clips and lifts have equal weight. Each parameter is changed by 25 % in both directions, a count
    by 1 at least. A change is adopted if the likelihood, times a weak prior around the shipped value, grows
    by more than two standard errors, and is then repeated. Fit to development clips only, and test with
    others. Twelve parameters take six minutes on two cores, without the simulation of the lifts. The images
    take 5 GB in --out.

    Examples:
      rig fit-slip clips --groups halves.csv --group development --out fit --save slip.json

      rig fit-slip clips --only keyframes --minutes 20 --out fit --resume

    """
    began = time.monotonic()
    chosen, tried = _chosen(options.only or []), _tried_before(run)
    with tempfile.TemporaryDirectory(prefix="rig_fit_slip_") as temporary:
        cases = _stored_cases(options, run, (run.folder or Path(temporary)) / "cases")
        search = _Search(cases, run, tried)
        left = [name for name in chosen if name not in {one.parameter for one in tried}]
        for place, name in enumerate(left):
            if options.minutes is not None and time.monotonic() - began > 60.0 * options.minutes:
                break
            search.improve(name, place)
            run.progress(place + 1, len(left), name)
        search.close()
    data = _data_rows(search, cases)
    rows = [row for name in chosen if (row := _row(name, search)) is not None]
    if options.save is not None:
        write_json(options.save, _card(search, options, data, rows))
    return Report(
        tables=(
            table_of("Likelihood of the true angles", DataRow, data),
            table_of("Parameters of slip, in rad, s and work pixels", ParameterRow, rows),
        ),
        figures={"parameters": search.values},
    )


def gain_of(
    cases: Sequence[Case], before: dict[Path, float], after: dict[Path, float]
) -> tuple[float, float]:
    """Return the gain of mean log likelihood on cases, and its standard error.

    before, after: the penalty of each case by folder. Versions of one clip are one unit.
    """
    gain, square = 0.0, 0.0
    kinds = {case.kind for case in cases}
    for kind in kinds:
        units: dict[str, list[float]] = {}
        for case in cases:
            if case.kind is kind:
                units.setdefault(case.unit, []).append(before[case.folder] - after[case.folder])
        means = np.array([np.mean(of) for of in units.values()])
        weight = _weight(kind, kinds)
        gain += weight * float(means.mean())
        square += weight**2 * float(means.var(ddof=1)) / len(means) if len(means) > 1 else 0.0
    return gain, math.sqrt(square)


def stepped(value: float, name: str, factor: float) -> float:
    """Return a parameter's value after a step. name: as in "keyframes.richer"."""
    short = name.rpartition(".")[2]
    if short in COUNTS:
        return max(1.0, math.ceil(factor * value) if factor > 1.0 else math.floor(factor * value))
    if short.endswith("share") or short in FRACTIONS:
        odds = factor * value / (1.0 - value)
        return odds / (1.0 + odds)
    return factor * value


def _penalty(task: tuple[Values, Case]) -> float:
    return penalty(*task)


class _Search:
    """Changes one parameter after the other, and keeps the changes that increase the likelihood."""

    def __init__(self, cases: Sequence[Case], run: Run, tried: list[Tried]) -> None:
        self._cases, self._run, self.tried = cases, run, tried
        self._tasks: list[tuple[Values, Case]] = []
        # The workers stay until all tasks are done, and more tasks are added before that.
        self._done = run_tasks(_penalty, self._tasks, run.workers)
        self.values = shipped()
        self.before = self.penalties = self._scored(self.values, cases)
        for one in tried:
            if one.adopted:
                self.values = _changed(self.values, one.parameter, one.value)
        if any(one.adopted for one in tried):
            self.penalties = self._scored(self.values, cases)

    def improve(self, name: str, place: int) -> None:
        """Change a parameter in both directions. place: of the parameter, selects the first cases."""
        for factor in (1.0 / STEP, STEP):
            steps = 0
            while self._step(name, factor, place):
                steps += 1
            if steps:
                return

    def close(self) -> None:
        """End the workers, which have no tasks any more."""
        for _ in self._done:
            pass

    def _scored(self, values: Values, cases: Sequence[Case]) -> dict[Path, float]:
        """Return the penalty of each case, by its folder."""
        self._tasks += [(values, case) for case in cases]
        return {task[1].folder: result for task, result in islice(self._done, len(cases))}

    def _step(self, name: str, factor: float, place: int) -> bool:
        group, _, short = name.partition(".")
        before = self.values[group][short]
        value = stepped(before, name, factor)
        changed = _changed(self.values, name, value)
        units = sorted({(case.kind, case.unit) for case in self._cases})
        part = {unit for number, unit in enumerate(units) if (number + place) % PARTS == 0}
        some = [case for case in self._cases if (case.kind, case.unit) in part]
        found = self._scored(changed, some)
        gain, error = gain_of(some, self.penalties, found)
        if complete := gain > 0.0:
            found |= self._scored(changed, [case for case in self._cases if case not in some])
            gain, error = gain_of(self._cases, self.penalties, found)
        center = shipped()[group][short]
        likelier = _unlikely(before / center) - _unlikely(value / center)
        adopted = complete and gain + likelier > SURE * error
        one = Tried(name, before, value, gain, error, complete, adopted)
        self.tried.append(one)
        if self._run.folder is not None:
            append_line(self._run.folder / TRIED, json_line(one))
        if adopted:
            self.values, self.penalties = changed, found
        return adopted


def _unlikely(ratio: float) -> float:
    """Return the negative log prior of a parameter, per independent error. ratio: to the shipped value."""
    return 0.5 * math.log(ratio) ** 2 / INDEPENDENT


def _changed(values: Values, name: str, value: float) -> Values:
    group, _, short = name.partition(".")
    return values | {group: values[group] | {short: value}}


def _chosen(only: Sequence[str]) -> list[str]:
    """Return the names of the parameters to fit. Raises `InputError` for an unknown name."""
    groups = shipped()
    names = [f"{group}.{name}" for group, of in groups.items() for name in of]
    if unknown := [one for one in only if one not in names and one not in groups]:
        raise InputError(unknown_name("parameter", unknown[0], [*groups, *names]))
    return [name for name in names if not only or name in only or name.partition(".")[0] in only]


def _tried_before(run: Run) -> list[Tried]:
    """Return the changes that the run in the folder has tried."""
    if run.folder is None:
        return []
    file = run.folder / TRIED
    drop_torn_line(file)
    tried = read_rows(file, Codec[Tried](Tried))
    if tried and not run.resume:
        raise InputError(f"{run.folder}: holds a fit; continue it with --resume, or give another folder")
    return tried


def _stored_cases(options: FitOptions, run: Run, folder: Path) -> list[Case]:
    """Store the images of all cases that are not in the folder."""
    clips = read_clips(options.folder, options.groups)
    names = sorted({clip.group for clip in clips})
    if options.group is not None and options.group not in names:
        raise InputError(unknown_name("group", options.group, names))
    of_group = [clip for clip in clips if options.group in (None, clip.group)]
    versions = [(clip_version(clip, version), clip.name) for version in ClipVersion for clip in of_group]
    cases = [store_clip(folder / clip.name, clip, unit) for clip, unit in versions]
    numbers = range(FIRST_LIFT, FIRST_LIFT + LIFTS_OF_RENDERER * options.lifts)
    places = [(folder / f"renderer {number}", number) for number in numbers]
    cases += run.each(_rendered, places, lambda place: place[0].name)
    for name, count in (("fake", (options.lifts + 1) // 2), ("hard", options.lifts)):
        bench = load_calibrated_bench(name, run.say)
        lifts = [
            LiftCase(bench.name, FIRST_SEED, object_id, lift)
            for object_id in resolve_objects([], bench.objects)
            for lift in range(1, count + 1)
        ]
        cases += run.each(partial(_carried_out, folder, bench), lifts)
    return cases


def _rendered(place: tuple[Path, int]) -> Case:
    return store_rendered(*place)


def _carried_out(folder: Path, bench: BenchConfig, lift: LiftCase) -> Case:
    return store_lift(folder / str(lift).replace("/", " "), bench, lift)


def _weight(kind: Kind, kinds: Collection[Kind]) -> float:
    """Return the weight of a kind among the given ones: clips count as much as all simulated lifts."""
    if len(kinds) == 1:
        return 1.0
    if Kind.CLIP not in kinds:
        return 1.0 / len(kinds)
    return 0.5 if kind is Kind.CLIP else 0.5 / (len(kinds) - 1)


def _data_rows(search: _Search, cases: Sequence[Case]) -> list[DataRow]:
    of_kind = {kind: [case.folder for case in cases if case.kind is kind] for kind in Kind}
    return [
        DataRow(
            kind.value,
            len(folders),
            float(np.mean([search.before[folder] for folder in folders])),
            float(np.mean([search.penalties[folder] for folder in folders])),
        )
        for kind, folders in of_kind.items()
        if folders
    ]


def _row(name: str, search: _Search) -> ParameterRow | None:
    steps = [one for one in search.tried if one.parameter == name]
    if not steps:
        return None
    group, _, short = name.partition(".")
    first = steps[0].before
    smaller = next((one for one in steps if one.before == first and one.value < first), None)
    larger = next((one for one in steps if one.before == first and one.value > first), None)
    return ParameterRow(
        name,
        first,
        search.values[group][short],
        None if smaller is None else smaller.gain,
        None if larger is None else larger.gain,
        max(one.error for one in steps),
    )


def _card(
    search: _Search, options: FitOptions, data: Sequence[DataRow], rows: Sequence[ParameterRow]
) -> dict[str, object]:
    """Return the parameters and a description of the data that they were fitted to."""
    return {
        "title": "parameters of the estimator slip",
        "made_with": "rig fit-slip",
        "clips": {"group": options.group or "all", "versions": [*ClipVersion]},
        "simulated_lifts": {
            "seed": FIRST_SEED,
            "first_of_renderer": FIRST_LIFT,
            "of_each_object": options.lifts,
        },
        "mean_negative_log_likelihood": [asdict(row) for row in data],
        "tried": [row.parameter for row in rows],
        "changed": [asdict(row) for row in rows if row.before != row.fitted],
        "parameters": search.values,
    }


STUDY = Study(
    name="fit-slip", options=FitOptions, measure=measure, cases="parameters", shared=("out", "resume", "jobs")
)
