"""`rig fit-slip`: fits the parameters of slip to clips and SIMULATED lifts with known angles.

The images are stored once and read as memory maps, because the estimator runs on each case many times.
"""

import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from itertools import islice, product
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, unknown_name
from rig.benchmark.clips.labelled import ClipVersion, LabelledClip, clip_version, read_clips
from rig.benchmark.estimators.contenders import KnownLift, open_lift
from rig.benchmark.harness import Cell, Report, Run, Study, table_of
from rig.benchmark.renderer import drawn_lift
from rig.benchmark.seeds import LiftCase, lift_cases, recorded_lift
from rig.config import BenchConfig
from rig.config.calibrations import load_calibrated_bench
from rig.declared import argument, option
from rig.experiments.process_pool import run_tasks
from rig.experiments.trial import resolve_objects
from rig.frames.of_session import SessionSeries
from rig.lift.object_angle import TipTrack, object_angle
from rig.sessions.codec import Codec, json_line
from rig.sessions.files import append_line, drop_torn_line, write_json
from rig.sessions.rows import read_rows
from rig.tactile.angles import Angles
from rig.tactile.sample import SlipSample
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.parameters import Values, shipped, use

STRIDE = 15  # every 15th frame of a lift counts, because the errors of neighbouring frames are correlated
RESOLUTION_DEG = 0.3  # errors below the one of the markers (contract) do not matter; added to sigma
OUTLIERS, ANY_DEG = 0.01, 120.0
"""Fraction of outliers, as many as may be confidently wrong. Outliers and refused angles are uniformly
distributed over this range, degrees."""
STEP = 1.25  # a parameter is changed by this factor; for a fraction, its odds are
FRACTIONS = frozenset(
    "good_score plain_fit least_richness least_count resting turning sticks anything correlation".split()
)
"""Parameters between 0 and 1, besides those whose name ends with "share"."""
COUNTS = frozenset("used check_frames iterations".split())
"""Parameters that are numbers of things: at least 1, and changed by 1 at least."""
SURE = 2.0  # a gain must exceed this many of its standard errors: by chance one change of 40 does
INDEPENDENT = 12.0
"""Number of independent errors that the prior is compared with: those in a clip and its versions are
correlated. The prior of a parameter is log-normal around the shipped value, with a factor e as its width."""
PARTS = 4  # a change is tried on one part of the cases first, and on the others only if it improves that part
TRUTH, TRIED = "truth.npz", "tried.jsonl"
"""Files: of a case, written last; of the run, with a line per change that was tried."""
LIFTS_OF_RENDERER = 4
FIRST_SEED, FIRST_LIFT = 900, 900
"""Seed of the lifts on the benches, and first lift of the second renderer. Benchmarks use lower numbers."""

Arrays = Mapping[str, Any]
"""The truth of a case: zero_ns (start of the lift, or time of the reference), end_ns, and the arrays
times_ns, angles_deg and sigmas_deg, (M,)."""
Known = tuple[float | None, float | None, float, float]  # angle and sigma, true angle and its sigma, degrees


@dataclass(frozen=True, slots=True)
class FitOptions:
    folder: Path = argument(..., "Labelled clips, as of rig benchmark clips.")
    groups: Path | None = option(None, "CSV with columns clip,group, as of rig benchmark clips.")
    group: str | None = option(None, "Only the clips of this group. Default: all clips.")
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
    save: Path | None = option(None, "File for the fitted parameters and their card.")


class Kind(StrEnum):
    """Where a case comes from."""

    CLIP = "clips"
    RENDERER = "second renderer"
    EASY = "bench fake"
    HARD = "bench hard"


@dataclass(frozen=True, slots=True)
class Case:
    """A clip or a lift in a folder. unit: cases of the same unit are versions of each other."""

    kind: Kind
    unit: str
    folder: Path

    @property
    def stored(self) -> bool:
        return (self.folder / TRUTH).exists()


@dataclass(frozen=True, slots=True)
class Tried:
    """A change of one parameter: its gain of mean log likelihood, the standard error, and the decision."""

    parameter: str
    before: float
    value: float
    gain: float
    error: float
    complete: bool  # whether it was tried on all cases
    adopted: bool


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
    groups, only = shipped(), options.only or []
    names = [f"{group}.{name}" for group, of in groups.items() for name in of]
    if unknown := [one for one in only if one not in names and one not in groups]:
        raise InputError(unknown_name("parameter", unknown[0], [*groups, *names]))
    chosen = [name for name in names if not only or name in only or name.partition(".")[0] in only]
    tried = _tried_before(run)
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
    data = []
    for kind in Kind:
        if of := [case.folder for case in cases if case.kind is kind]:
            before, fitted = (
                float(np.mean([by[each] for each in of])) for by in (search.before, search.penalties)
            )
            row = [
                Cell("data", kind.value, "data"),
                Cell("cases", len(of), "cases"),
                Cell("before", before, "before", ".3f", "mean negative log likelihood"),
                Cell("fitted", fitted, "fitted", ".3f", "the same with the fitted parameters"),
            ]
            data.append(row)
    tables = [table_of("Likelihood of the true angles", data)]
    if rows := [row for name in chosen if (row := _row(name, search))]:
        tables.append(table_of("Parameters of slip, in rad, s and work pixels", rows))
    if options.save is not None:
        write_json(options.save, _card(search, options, *(table.records for table in tables)))
    return Report(tables, figures={"parameters": search.values})


def _tried_before(run: Run) -> list[Tried]:
    if run.folder is None:
        return []
    file = run.folder / TRIED
    drop_torn_line(file)
    tried = read_rows(file, Codec[Tried](Tried))
    if tried and not run.resume:
        raise InputError(f"{run.folder}: holds a fit; continue it with --resume, or give another folder")
    return tried


def _stored_cases(options: FitOptions, run: Run, folder: Path) -> list[Case]:
    clips = read_clips(options.folder, options.groups)
    names = sorted({clip.group for clip in clips})
    if options.group is not None and options.group not in names:
        raise InputError(unknown_name("group", options.group, names))
    of_group = [clip for clip in clips if options.group in (None, clip.group)]
    cases = []
    for version, plain in product(ClipVersion, of_group):
        clip = clip_version(plain, version)
        case = Case(Kind.CLIP, plain.name, folder / clip.name)
        cases.append(case if case.stored else store(case, clip_lift(clip)))
    numbers = range(FIRST_LIFT, FIRST_LIFT + LIFTS_OF_RENDERER * options.lifts)
    cases += run.each(partial(store_rendered, folder), numbers, "renderer {}".format)
    for name, count in (("fake", (options.lifts + 1) // 2), ("hard", options.lifts)):
        bench = load_calibrated_bench(name, run.say)
        lifts = lift_cases(bench.name, [FIRST_SEED], resolve_objects([], bench.objects), count)
        cases += run.each(partial(store_lift, folder, bench), lifts)
    return cases


def clip_lift(clip: LabelledClip) -> KnownLift:
    """Return a clip as a lift: its true angles are the labels, and its lift begins at the reference."""
    frames = list(clip.series.read())
    times_ns = np.array([frame.time.time_ns for frame in frames], np.int64)
    labels = np.array([(label.frame, label.angle_deg, label.sigma_deg) for label in clip.labels])
    start_ns, end_ns = int(times_ns[clip.reference_frame]), int(times_ns[-1])
    since_s = (times_ns[labels[:, 0].astype(int)] - start_ns) / NS_PER_S
    truth = Angles(since_s, labels[:, 1], labels[:, 2], zero_ns=start_ns)
    tip = SessionSeries(
        clip.name, "", 1, None, clip.background, replace(clip.series, read=lambda: iter(frames))
    )
    return KnownLift(clip.name, {"": tip}, truth, start_ns, end_ns, end_ns)


def store_rendered(folder: Path, number: int) -> Case:
    case = Case(Kind.RENDERER, f"renderer {number}", folder / f"renderer {number}")
    if not case.stored:
        lift = drawn_lift(number)
        store(case, replace(lift, end_ns=lift.end_ns - 1))  # without the last frame
    return case


def store_lift(folder: Path, bench: BenchConfig, lift: LiftCase) -> Case:
    """Carry out a lift on a simulated bench and store it below a folder, unless it is stored."""
    name = str(lift).replace("/", " ")
    case = Case(Kind.HARD if bench.difficulty == "hard" else Kind.EASY, name, folder / name)
    if not case.stored:
        with recorded_lift(bench, lift) as (recording, _):
            store(case, open_lift(recording, name))
    return case


def store(case: Case, lift: KnownLift) -> Case:
    """Store the frames of a lift or clip, and its true angles."""
    case.folder.mkdir(parents=True, exist_ok=True)
    for number, tip in enumerate(lift.tips.values()):
        shown = [(of.time.time_ns, of.image) for of in tip.frames.read() if of.image is not None]
        np.save(case.folder / f"images_{number}.npy", np.stack([image for _, image in shown]))
        times_ns = np.array([time_ns for time_ns, _ in shown], np.int64)
        sensor: dict[str, Any] = {"sign": tip.sign, "background": tip.background, "times_ns": times_ns}
        aspect = math.nan if tip.aspect is None else tip.aspect
        np.savez(case.folder / f"tip_{number}.npz", aspect=np.array(aspect), **sensor)
    truth: dict[str, Any] = {"zero_ns": lift.lift_ns, "end_ns": lift.end_ns, "times_ns": lift.truth.time_ns}
    truth |= {"angles_deg": lift.truth.angle_deg, "sigmas_deg": lift.truth.sigma_deg}
    np.savez(case.folder / TRUTH, **truth)
    return case


def penalty(task: tuple[Values, Case]) -> float:
    """Return the mean negative log likelihood of the true angles of a case, given the reported ones.

    Runs in a worker process, and leaves the values in use there.
    """
    cv2.setNumThreads(1)
    values, case = task
    use(values)
    truth = dict(np.load(case.folder / TRUTH))
    signs, samples = [], []
    for number in range(len(list(case.folder.glob("tip_*.npz")))):
        of = np.load(case.folder / f"tip_{number}.npz")
        aspect, images = float(of["aspect"]), np.load(case.folder / f"images_{number}.npy", mmap_mode="r")
        estimator = SlipEstimator(of["background"], None if math.isnan(aspect) else aspect)
        shown = zip(images, of["times_ns"], strict=True)
        samples.append([estimator.update(np.asarray(image), int(time_ns)) for image, time_ns in shown])
        signs.append(int(of["sign"]))
    known = _at_labels(samples[0], truth) if case.kind is Kind.CLIP else _in_lift(signs, samples, truth)
    return float(np.mean([surprise(*one) for one in known]))


def surprise(
    angle_deg: float | None, sigma_deg: float | None, true_deg: float, true_sigma_deg: float
) -> float:
    outlier = 1.0 / ANY_DEG
    if angle_deg is None or sigma_deg is None:
        return -math.log(outlier)
    variance = sigma_deg**2 + true_sigma_deg**2 + RESOLUTION_DEG**2
    normal = math.exp(-0.5 * (angle_deg - true_deg) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
    return -math.log((1.0 - OUTLIERS) * normal + OUTLIERS * outlier)


def _at_labels(samples: Sequence[SlipSample], truth: Arrays) -> Iterator[Known]:
    track = TipTrack(1, list(samples))
    later = [s for s in samples if s.time_ns >= truth["zero_ns"] and s.angle_deg is not None]
    track.zero_sample = later[0] if later else None
    track.zero_deg = later[0].angle_deg if later else None
    by_time = {sample.time_ns: sample for sample in samples}
    for time_ns, angle, sigma in zip(
        truth["times_ns"], truth["angles_deg"], truth["sigmas_deg"], strict=True
    ):
        sample = by_time.get(int(time_ns))
        answer = None if sample is None else track.answer(sample)
        yield answer and answer.angle_deg, answer and answer.sigma_deg, angle, sigma


def _in_lift(signs: Sequence[int], samples: Sequence[list[SlipSample]], truth: Arrays) -> Iterator[Known]:
    names = [str(number) for number in range(len(signs))]
    by_name = dict(zip(names, samples, strict=True))
    angle = object_angle(dict(zip(names, signs, strict=True)), by_name, int(truth["zero_ns"]))
    answers = [[tip.answer(s) for s in tip.samples] for tip in angle.tips.values()]
    for series in (*answers, angle.fused[:: len(signs)]):
        inside = [s for s in series if truth["zero_ns"] <= s.time_ns < truth["end_ns"]]
        for s in inside[::STRIDE]:
            true, sigma = (
                float(np.interp(s.time_ns, truth["times_ns"], truth[of]))
                for of in ("angles_deg", "sigmas_deg")
            )
            yield s.angle_deg, s.sigma_deg, true, sigma


def gain_of(
    cases: Sequence[Case], before: dict[Path, float], after: dict[Path, float]
) -> tuple[float, float]:
    """Return the gain of mean log likelihood and its standard error. before, after: penalties by folder."""
    gain, square = 0.0, 0.0
    kinds = {case.kind for case in cases}
    for kind in kinds:
        units: dict[str, list[float]] = {}
        for case in cases:
            if case.kind is kind:
                units.setdefault(case.unit, []).append(before[case.folder] - after[case.folder])
        means = np.array([np.mean(of) for of in units.values()])
        weight = 1.0 / len(kinds)
        if Kind.CLIP in kinds and len(kinds) > 1:  # clips count as much as all simulated lifts
            weight = 0.5 if kind is Kind.CLIP else 0.5 / (len(kinds) - 1)
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


class _Search:
    """Changes one parameter after the other, and keeps the changes that increase the likelihood."""

    def __init__(self, cases: Sequence[Case], run: Run, tried: list[Tried]) -> None:
        self._cases, self._run, self.tried = cases, run, tried
        self._tasks: list[tuple[Values, Case]] = []
        # The workers stay until all tasks are done, and more tasks are added before that.
        self._done = run_tasks(penalty, self._tasks, run.workers)
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
        for _ in self._done:
            pass

    def _scored(self, values: Values, cases: Sequence[Case]) -> dict[Path, float]:
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
        # the difference of the log prior, per independent error
        likelier = 0.5 * (math.log(before / center) ** 2 - math.log(value / center) ** 2) / INDEPENDENT
        adopted = complete and gain + likelier > SURE * error
        one = Tried(name, before, value, gain, error, complete, adopted)
        self.tried.append(one)
        if self._run.folder is not None:
            append_line(self._run.folder / TRIED, json_line(one))
        if adopted:
            self.values, self.penalties = changed, found
        return adopted


def _changed(values: Values, name: str, value: float) -> Values:
    group, _, short = name.partition(".")
    return values | {group: values[group] | {short: value}}


def _row(name: str, search: _Search) -> list[Cell]:
    """Return the row of a parameter, [] if it was not tried."""
    steps = [one for one in search.tried if one.parameter == name]
    if not steps:
        return []
    group, _, short = name.partition(".")
    first, error = steps[0].before, max(one.error for one in steps)
    smaller = next((one.gain for one in steps if one.before == first and one.value < first), None)
    larger = next((one.gain for one in steps if one.before == first and one.value > first), None)
    return [
        Cell("parameter", name, "parameter"),
        Cell("before", first, "before", ".4g"),
        Cell("fitted", search.values[group][short], "fitted", ".4g"),
        Cell("smaller", smaller, "gain if smaller", "+.4f", "of mean log likelihood, by the first step"),
        Cell("larger", larger, "gain if larger", "+.4f"),
        Cell("error", error, "standard error", ".4f"),
    ]


def _card(
    search: _Search, options: FitOptions, data: Sequence[Any], rows: Sequence[Any] = ()
) -> dict[str, object]:
    """Return the contents of the file of --save. data, rows: the records of the two tables."""
    lifts = {"seed": FIRST_SEED, "first_of_renderer": FIRST_LIFT, "of_each_object": options.lifts}
    return {
        "title": "parameters of the estimator slip",
        "made_with": "rig fit-slip",
        "clips": {"group": options.group or "all", "versions": [*ClipVersion]},
        "simulated_lifts": lifts,
        "mean_negative_log_likelihood": list(data),
        "tried": [row["parameter"] for row in rows],
        "changed": [row for row in rows if row["before"] != row["fitted"]],
        "parameters": search.values,
    }


STUDY = Study("fit-slip", FitOptions, measure, "parameters", ("out", "resume", "jobs"))
