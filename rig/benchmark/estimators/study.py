"""`rig benchmark estimators`: measure run time and error of every estimator, on lifts and disturbed clips."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from drivers.errors import plural
from protocols.grasps import TRIAL_OBJECTS
from rig.benchmark.estimators import contenders
from rig.benchmark.estimators.contenders import CONTENDERS, PAPER, ContenderScore, score_all
from rig.benchmark.estimators.stress import NAMES, StressRow, run_stress, stress_rows, stress_tasks
from rig.benchmark.harness import Cell, Report, Run, Study, Table, processor_and_cores, table_of
from rig.benchmark.measured import NONE, Measured, at_least, at_most, between, informative
from rig.benchmark.timing import AS_MULTIPLE, REFERENCE, TIMES_REFERENCE
from rig.config import BenchConfig, load_bench
from rig.declared import option
from rig.experiments.lift_plan import TrialSettings, stored_trial
from rig.experiments.trial import run_trial
from rig.results.metrics import HEADING, mare_text
from rig.sessions.manifest import is_session
from rig.sessions.records import Lift
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import DEFAULT_ESTIMATOR, ECC, PAPER_WINDOW, EstimatorChoice, choose_estimator
from rig.tactile.sample import together

LIFTS = 5  # lifts of each object that are recorded
TIMED_LIFTS = 5
TABLE = "table.md"
README_COLUMNS = 11  # number of columns of the table of estimators in a document
MARE_DEG, ELONGATED_DEG, WORST_DEG = 0.5, 0.25, 2.0
ANSWERED, REFUSED = 0.95, 0.95
WITHIN_LEAST, WITHIN_MOST = 0.90, 0.98
TIMES_MORE_ACCURATE, TIMES_FASTER = 5.0, 10.0
FRAME_SIZE_PX = (240, 320)  # frame size for which the limit on the ratio of run times applies
PAPER_BEST = ("skeleton", 2)
"""Best method and window in the paper (1.85 degrees); here the faults of its script are corrected."""


@dataclass(frozen=True, slots=True)
class EstimatorsOptions:
    session: Path | None = option(None, "Trial whose lifts are used. Default: record 45 simulated lifts.")
    estimator: list[str] | None = option(
        None, "Additional estimator to compare, as package.module:Class; repeat for more."
    )


@dataclass(frozen=True, slots=True)
class EstimatorsResult:
    session: Path  # folder of the lifts
    simulated: bool
    seed: int
    more: tuple[str, ...]  # additional estimators given by the user
    lifts: Sequence[contenders.LiftScores]
    scores: dict[tuple[str, int], ContenderScore]  # by estimator and window, over all lifts
    timing: contenders.TimingReport
    stress: Sequence[StressRow]

    @property
    def closest_of_paper(self) -> tuple[str, int] | None:
        """The paper's method and window (2 to 10) with the lowest MARE on these lifts; None without any."""
        known = {
            key: score.mare.mean_deg
            for key, score in self.scores.items()
            if key[0] in PAPER and key[1] >= 2 and score.mare
        }
        return min(known, key=known.__getitem__, default=None)

    @property
    def usual(self) -> list[tuple[str, int]]:
        """Each estimator with its default window, and the paper's best method if it is not among them."""
        keys = [(DEFAULT_ESTIMATOR, 1), (ECC, 1), *((name, PAPER_WINDOW) for name in PAPER)]
        keys += [(name, 1) for name in self.more if (name, 1) not in keys]
        best = self.closest_of_paper
        return keys + ([best] if best and best not in keys else [])

    @property
    def skipped(self) -> dict[str, float]:
        """Fraction of the frames in which each stage was skipped."""
        frames = sum(lift.frames for lift in self.lifts)
        stages = dict.fromkeys(stage for lift in self.lifts for stage in lift.skipped)
        return {stage: sum(lift.skipped.get(stage, 0) for lift in self.lifts) / frames for stage in stages}


def measure(options: EstimatorsOptions, run: Run) -> Report:
    """Measure run time and error of every estimator, on 45 lifts and on disturbed clips.

    It takes about 8 minutes on two idle cores. Run time is measured in one process and one thread, through
    `rig.estimator` with its checks, and beside OpenCV's findTransformECC; errors are computed for every
    window. The folder of the results holds results.json, table.md and the recorded lifts; an interrupted
    recording continues there. The exit code is 4 if the default estimator misses a limit.

    Examples:
      rig benchmark
      rig benchmark estimators --session sessions/2026-11-21T093000_trial --out benchmark
      rig benchmark estimators --readme docs/measurements.md
      rig benchmark estimators --estimator my_lab.rotation:MyEstimator --out benchmark
    """
    return report_of(compare(options, run))


def compare(options: EstimatorsOptions, run: Run) -> EstimatorsResult:
    """Measure all estimators on lifts and on disturbed clips. Raises the errors of `run_trial`."""
    more = tuple(options.estimator or ())
    for name in more:
        choose_estimator(name)
    names, stressed = (tuple(dict.fromkeys((*of, *more))) for of in (CONTENDERS, NAMES))
    folder = options.session or record(
        run, "session", load_bench("fake"), choose_estimator(), TRIAL_OBJECTS, LIFTS
    )
    rows = read_finished_lifts(folder)
    # Evenly spread lifts include all kinds of objects.
    timed, step = min(TIMED_LIFTS, len(rows)), len(rows) // min(TIMED_LIFTS, len(rows)) // 2
    spread_out = [rows[i * len(rows) // timed + (i % 2) * step] for i in range(timed)]
    # Run time is measured first and alone, because worker processes would compete for the core.
    timing = contenders.time_lifts(folder, spread_out, run.progress, names)
    lifts = run.each(
        partial(contenders.score_lift, folder, names),
        rows,
        lambda row: f"estimators on {row.object}/{row.lift}",
    )
    disturbed = partial(run_stress, run.seed, stressed)
    clips = run.each(disturbed, stress_tasks(), lambda of: f"stress: {of[0]}, {of[1]}, seed {run.seed}")
    return EstimatorsResult(
        session=folder,
        simulated=stored_trial(folder).manifest.simulated,
        seed=run.seed,
        more=more,
        lifts=lifts,
        scores={key: score_all([lift.scores[key] for lift in lifts]) for key in lifts[0].scores},
        timing=timing,
        stress=stress_rows([clip for of in clips for clip in of]),
    )


def record(
    run: Run, name: str, bench: BenchConfig, estimator: EstimatorChoice, objects: Sequence[str], lifts: int
) -> Path:
    """Carry out a session's missing simulated lifts in the folder of the results; return its folder."""
    folder = (run.folder or Path()) / name
    trial = TrialSettings(bench, run.seed, estimator)

    def show(done: int, total: int, row: Lift) -> None:
        run.progress(done, total, f"{name}: {row.object}/{row.lift} {row.outcome}")

    run_trial(folder, trial, list(objects), lifts, run.workers, is_session(folder), progress=show)
    return folder


def report_of(result: EstimatorsResult) -> Report:
    limits, best = judge(result), result.closest_of_paper
    section, costs = readme_section(result, limits), result.timing.contenders
    failed = dict.fromkeys(name for lift in result.lifts for name in lift.faults)
    windows = [
        {"estimator": name, "window": window, **asdict(score)}
        | {"p50_ms": costs[name].contact.p50_ms, "p99_ms": costs[name].contact.p99_ms}
        for (name, window), score in result.scores.items()
    ]
    return Report(
        tables=(time_table(result), stress_table(result), estimator_table(result)),
        limits=limits,
        limits_of=f"'{DEFAULT_ESTIMATOR}'",
        notes=_notes(result),
        section=section,
        figures={
            "simulated": result.simulated,
            "session": str(result.session),
            "lifts": len(result.lifts),
            "estimators": windows,
            "closest_of_paper": None if best is None else {"estimator": best[0], "window": best[1]},
            "timing": asdict(result.timing),
            "skipped_share": result.skipped,
        },
        files={TABLE: section + "\n"},
        faults={
            name: together([lift.faults[name] for lift in result.lifts if name in lift.faults])
            for name in failed
        },
    )


def judge(result: EstimatorsResult) -> list[Measured]:
    ours, timing = result.scores[DEFAULT_ESTIMATOR, 1], result.timing
    theirs_deg = result.scores[PAPER_BEST].mare_deg
    better = theirs_deg / ours.mare_deg if theirs_deg and ours.mare_deg else None
    round_ones = [r for r in result.stress if r.refused and r.estimator == DEFAULT_ESTIMATOR]
    refused = [1.0 - row.score.answered for row in round_ones]
    cost = timing.contenders[DEFAULT_ESTIMATOR].contact
    known = timing.size_px == FRAME_SIZE_PX and cost.count > 0
    faster = timing.published.p50_ms / cost.p50_ms if known else None
    elongated_deg = ours.mare_elongated and ours.mare_elongated.mean_deg
    paper = f"times as accurate as the paper's best method ({PAPER_BEST[0]}, window {PAPER_BEST[1]})"
    return [
        at_most("MARE over all lifts, deg", ours.mare_deg, MARE_DEG),
        at_most("MARE over elongated objects, deg", elongated_deg, ELONGATED_DEG),
        at_most("mean error of the worst lift, deg", ours.worst_deg, WORST_DEG),
        at_least("share of frames answered", ours.answered, ANSWERED),
        between("share of errors within two sigma", ours.within_two_sigma, WITHIN_LEAST, WITHIN_MOST),
        at_least(paper, better, TIMES_MORE_ACCURATE),
        at_least("share of frames refused on smooth round contacts", min(refused, default=None), REFUSED),
        informative("frame with contact in to angle out, median, ms", cost.p50_ms),
        informative("frame with contact in to angle out, 99th percentile, ms", cost.p99_ms),
        at_least("times as fast as the published second stage", faster, TIMES_FASTER),
    ]


def estimator_table(result: EstimatorsResult) -> Table:
    """Return a row per estimator with its usual window, and one for the paper's method that is best here."""
    lifts = plural(len(result.lifts), "lift")
    title = f"{'SIMULATED ' * result.simulated}rotational error in degrees over {lifts}, and run time"
    rows = []
    for name, window in result.usual:
        score, cost = result.scores[name, window], result.timing.contenders[name].contact
        reference = result.timing.contenders[REFERENCE].contact.p50_ms
        times = cost.p50_ms / reference if cost.count and reference else None
        held_deg = score.mare_held and score.mare_held.mean_deg
        elongated_deg = score.mare_elongated and score.mare_elongated.mean_deg
        onset_ms = None if score.onset.error_s is None else 1e3 * score.onset.error_s
        held, event = "refused frames keep the last angle", score.event
        within = event and event.within
        row = [
            Cell("estimator", name, "estimator"),
            Cell("window", window, "window", lambda n: NONE if n == 1 else str(n), "1: no filter"),
            Cell("ms", (cost.p50_ms, cost.p99_ms), "ms per frame with contact: median, 99 %", ".2f"),
            Cell("times_reference", times, TIMES_REFERENCE, ".2f", AS_MULTIPLE),
            Cell("mare", score.mare, "MARE, B and C", mare_text),
            Cell("mare_b", score.mare_b, "MARE, B", mare_text),
            Cell("held_deg", held_deg, held, ".2f", "MARE if a refused frame counts with the last angle"),
            Cell("elongated_deg", elongated_deg, "elongated", ".2f", "MARE of elongated objects"),
            Cell("worst", score.worst_text, "worst lift", "", "largest mean error of a lift, and the lift"),
            Cell("answered", score.answered, "answered", ".1%", "share of the frames"),
            Cell("within_two_sigma", score.within_two_sigma, "within 2 sigma", ".1%", "share of the answers"),
            Cell("onset_ms", onset_ms, "onset error, ms", ".0f", "median"),
            Cell("event_within", within, "event within 50 ms", "", "share of the true onsets"),
            Cell("false_events", event and event.false_alarms, "false events"),
        ]
        rows.append(row)
    return table_of(title, rows)


def time_table(result: EstimatorsResult) -> Table:
    rows = []
    for name, of in result.timing.contenders.items():
        rows += [(name, "frame in to angle out", of.contact), *(("", *stage) for stage in of.stages.items())]
    rows.append(("published second stage", "mask to angle, full picture", result.timing.published))
    width, height = result.timing.size_px
    cells = [
        [Cell("estimator", name, "estimator"), Cell("stage", stage, "stage"), Cell("spread", spread)]
        for name, stage, spread in rows
    ]
    title = f"Run time, {processor_and_cores()}, one thread, {width} x {height} px, frames with contact"
    return table_of(title, cells, left=2)


def stress_table(result: EstimatorsResult) -> Table:
    """Return the MARE per condition and estimator, with the share of frames with an angle if not 1."""

    def cell(row: StressRow | None) -> str:
        if row is None:
            return NONE
        if row.refused:
            return f"refused {1.0 - row.score.answered:.0%}"
        mean = _mean(row.score.mare_deg)
        return mean if row.score.answered >= 0.995 else f"{mean} ({row.score.answered:.0%})"

    by = {(row.condition, row.estimator): row for row in result.stress}
    names = tuple(dict.fromkeys((*NAMES, *(row.estimator for row in result.stress))))
    rows = []
    for group, condition in dict.fromkeys((row.group, row.condition) for row in result.stress):
        ours = by.get((condition, DEFAULT_ESTIMATOR))
        within = ours.score.within_two_sigma if ours else None
        cells = (cell(by.get((condition, name))) for name in names)
        rows.append((group, condition, *cells, NONE if within is None else f"{within:.1%}"))
    title = "SIMULATED clips with known angles: mean error in degrees (share of frames answered, if not all)"
    columns = ("group", "condition", *names, f"{DEFAULT_ESTIMATOR} within 2 sigma")
    return Table(title, columns, rows, left=2, records=tuple(result.stress))


def _mean(value_deg: float | None) -> str:
    return NONE if value_deg is None else f"{value_deg:.2f}"


def _notes(result: EstimatorsResult) -> list[str]:
    shares = ", ".join(f"{stage} {share:.0%}" for stage, share in result.skipped.items())
    scores = [(name, result.scores[name, window]) for name, window in result.usual]
    onsets = (
        f"{name} {of.onset.within or NONE} within 50 ms, {of.onset.missed} of {of.onset.true} missed"
        for name, of in scores
    )
    script = [(name, of.mare_unsigned) for name, of in scores if "published" in name]
    unsigned = (f"{name} {_mean(mare and mare.mean_deg)}" for name, mare in script)
    best, ours_deg = result.closest_of_paper, result.scores[DEFAULT_ESTIMATOR, 1].mare_deg
    theirs_deg = result.scores[best].mare_deg if best else None
    closest = "None of the paper's methods gave an answer."
    if best and ours_deg is not None and theirs_deg is not None:
        closest = (
            f"The closest of the paper's methods on these lifts is {best[0]} with window {best[1]}: "
            f"{theirs_deg:.2f} degrees, {theirs_deg / ours_deg:.1f} times ours."
        )
    return [
        f"Stages skipped, of all frames: {shares or 'none'}.",
        closest,
        "Onsets found afterwards: " + "; ".join(onsets) + ".",
        "The published methods know no sign: against the size of the true angle alone their MARE is "
        + f"{', '.join(unsigned)} degrees.",
    ]


def readme_section(result: EstimatorsResult, limits: Sequence[Measured]) -> str:
    table, missed = estimator_table(result), [limit.name for limit in limits if limit.met is False]
    rows = [row[:README_COLUMNS] for row in table.rows]
    head = (
        f"{'SIMULATED ' * result.simulated}{plural(len(result.lifts), 'lift')}, seed {result.seed}, "
        f"{processor_and_cores()}, one thread. Errors in degrees, {HEADING}."
    )
    verdict = f"Limits missed: {'; '.join(missed)}." if missed else "All limits were kept."
    return "\n".join([head, "", Table("", table.columns[:README_COLUMNS], rows).markdown(), "", verdict])


SHARED = ("out", "readme", "jobs", "seed")
STUDY = Study("estimators", EstimatorsOptions, measure, "steps", SHARED, keeps_results=True, simulated=False)
