"""Make the tables, limits and notes of `rig benchmark estimators`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import counted
from rig.benchmark.estimators.contenders import PAPER
from rig.benchmark.estimators.lifts import LiftScores
from rig.benchmark.estimators.scores import ContenderScore
from rig.benchmark.estimators.stress import NAMES, StressRow
from rig.benchmark.estimators.timing import Spread, TimingReport
from rig.benchmark.harness import NONE, Table, column, columns_of, machine, table_of
from rig.benchmark.measured import Measured, at_least, at_most, between, informative
from rig.results.metrics import HEADING, Mare, mare_text
from rig.results.shares import Share
from rig.tactile.estimators import DEFAULT_ESTIMATOR, ECC, PAPER_WINDOW

README_COLUMNS = 10
"""Number of columns of the table of estimators in a document."""

MARE_DEG, ELONGATED_DEG, WORST_DEG = 0.5, 0.25, 2.0
ANSWERED, REFUSED = 0.95, 0.95
WITHIN_LEAST, WITHIN_MOST = 0.90, 0.98
TIMES_MORE_ACCURATE, TIMES_FASTER = 5.0, 10.0
FRAME_SIZE_PX = (240, 320)
"""Frame size for which the limit on the ratio of run times applies."""
PAPER_BEST = ("skeleton", 2)
"""Best method and window in the paper (1.85 degrees); here the faults of its script are corrected."""


@dataclass(frozen=True, slots=True)
class EstimatorsResult:
    """All measurements.

    session: folder of the lifts. more: additional estimators given by the user. scores: by estimator and
    window, over all lifts.
    """

    session: Path
    simulated: bool
    seed: int
    more: tuple[str, ...]
    lifts: Sequence[LiftScores]
    scores: dict[tuple[str, int], ContenderScore]
    timing: TimingReport
    stress: Sequence[StressRow]

    @property
    def mark(self) -> str:
        """Prefix of titles: "SIMULATED " if the lifts are simulated, else ""."""
        return "SIMULATED " if self.simulated else ""

    @property
    def closest_of_paper(self) -> tuple[str, int] | None:
        """The paper's method and window (2 to 10) with the lowest MARE on these lifts; None without any."""
        known = {
            key: score.mare.mean_deg
            for key, score in self.scores.items()
            if key[0] in PAPER and key[1] >= 2 and score.mare
        }
        return min(known, key=lambda key: known[key]) if known else None

    @property
    def skipped(self) -> dict[str, float]:
        """Fraction of the frames in which each stage was skipped."""
        frames = sum(lift.frames for lift in self.lifts)
        stages = dict.fromkeys(stage for lift in self.lifts for stage in lift.skipped)
        return {stage: sum(lift.skipped.get(stage, 0) for lift in self.lifts) / frames for stage in stages}


@dataclass(frozen=True, slots=True)
class EstimatorRow:
    """One estimator with one window on all lifts; errors in degrees."""

    estimator: str = column("estimator")
    window: int = column("window", lambda n: NONE if n == 1 else str(n), "1: no filter")
    ms: tuple[float, float] = column("ms per frame with contact: median, 99 %", ".2f")
    mare: Mare | None = column("MARE, B and C", mare_text)
    mare_b: Mare | None = column("MARE, B", mare_text)
    held_deg: float | None = column(
        "refused frames keep the last angle", ".2f", "MARE if a refused frame counts with the last angle"
    )
    elongated_deg: float | None = column("elongated", ".2f", "MARE of elongated objects")
    worst: str = column("worst lift", doc="largest mean error of a lift, and the lift")
    answered: float = column("answered", ".1%", "share of the frames")
    within_two_sigma: float | None = column("within 2 sigma", ".1%", "share of the answers")
    onset_ms: float | None = column("onset error, ms", ".0f", "median")
    event_within: Share | None = column("event within 50 ms", doc="share of the true onsets")
    false_events: int | None = column("false events")


@dataclass(frozen=True, slots=True)
class TimeRow:
    """Run time of one stage, on frames with contact."""

    estimator: str = column("estimator")
    stage: str = column("stage")
    spread: Spread = columns_of(Spread)


def judge(result: EstimatorsResult) -> list[Measured]:
    """Return all limits in the order of the table."""
    ours, timing = result.scores[DEFAULT_ESTIMATOR, 1], result.timing
    mare = ours.mare and ours.mare.mean_deg
    theirs = result.scores[PAPER_BEST].mare
    better = theirs.mean_deg / mare if theirs and mare else None
    refused = [
        1.0 - r.score.answered for r in result.stress if r.refused and r.estimator == DEFAULT_ESTIMATOR
    ]
    cost = timing.contenders[DEFAULT_ESTIMATOR].contact
    known = timing.size_px == FRAME_SIZE_PX and cost.count > 0
    faster = timing.published.p50_ms / cost.p50_ms if known else None
    paper = f"times as accurate as the paper's best method ({PAPER_BEST[0]}, window {PAPER_BEST[1]})"
    return [
        at_most("MARE over all lifts, deg", mare, MARE_DEG),
        at_most(
            "MARE over elongated objects, deg",
            ours.mare_elongated and ours.mare_elongated.mean_deg,
            ELONGATED_DEG,
        ),
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
    lifts = counted(len(result.lifts), "lift")
    title = f"{result.mark}rotational error in degrees over {lifts}, and run time"
    return table_of(title, EstimatorRow, [_estimator_row(result, *key) for key in _usual(result)])


def time_table(result: EstimatorsResult) -> Table:
    """Return the percentiles of the run time of each stage, and of the published second stage."""
    rows = []
    for name, timing in result.timing.contenders.items():
        rows.append(TimeRow(name, "frame in to angle out", timing.contact))
        rows += [TimeRow("", stage, spread) for stage, spread in timing.stages.items()]
    rows.append(TimeRow("published second stage", "mask to angle, full picture", result.timing.published))
    width, height = result.timing.size_px
    title = f"Run time, one thread, {width} x {height} px, frames with contact"
    return table_of(title, TimeRow, rows, left=2)


def stress_table(result: EstimatorsResult) -> Table:
    """Return the MARE per condition and estimator, with the share of frames with an angle if not 1."""
    by = {(row.condition, row.estimator): row for row in result.stress}
    conditions = dict.fromkeys((row.group, row.condition) for row in result.stress)
    names = tuple(dict.fromkeys((*NAMES, *(row.estimator for row in result.stress))))
    rows = []
    for group, condition in conditions:
        ours = by.get((condition, DEFAULT_ESTIMATOR))
        cells = [_stress_cell(by.get((condition, name))) for name in names]
        rows.append((group, condition, *cells, _share(ours.score.within_two_sigma if ours else None)))
    title = "SIMULATED clips with known angles: mean error in degrees (share of frames answered, if not all)"
    columns = ("group", "condition", *names, f"{DEFAULT_ESTIMATOR} within 2 sigma")
    return Table(title, columns, rows, left=2, records=tuple(result.stress))


def notes(result: EstimatorsResult) -> list[str]:
    """Return further results, one sentence each."""
    shares = ", ".join(f"{stage} {share:.0%}" for stage, share in result.skipped.items())
    scores = [(name, result.scores[name, window]) for name, window in _usual(result)]
    onsets = (
        f"{name} {of.onset.within or NONE} within 50 ms, {of.onset.missed} of {of.onset.true} missed"
        for name, of in scores
    )
    unsigned = (f"{name} {_mean(of.mare_unsigned)}" for name, of in scores if "published" in name)
    return [
        f"Stages skipped, of all frames: {shares or 'none'}.",
        _against_paper(result),
        "Onsets found afterwards: " + "; ".join(onsets) + ".",
        "The published methods know no sign: against the size of the true angle alone their MARE is "
        + f"{', '.join(unsigned)} degrees.",
    ]


def readme_section(result: EstimatorsResult, limits: Sequence[Measured]) -> str:
    """Return the section for a document in Markdown, without the comments that mark it."""
    table, missed = estimator_table(result), [limit.name for limit in limits if limit.met is False]
    rows = [row[:README_COLUMNS] for row in table.rows]
    of = machine()
    return "\n".join(
        [
            f"{result.mark}{counted(len(result.lifts), 'lift')}, seed {result.seed}, "
            f"{of['processor']}, {of['cores']} cores, one thread. Errors in degrees, {HEADING}.",
            "",
            Table("", table.columns[:README_COLUMNS], rows).markdown(),
            "",
            f"Limits missed: {'; '.join(missed)}." if missed else "All limits were kept.",
        ]
    )


def _usual(result: EstimatorsResult) -> list[tuple[str, int]]:
    """Return each estimator with its default window, and the paper's best method if it is not among them."""
    keys = [(DEFAULT_ESTIMATOR, 1), (ECC, 1)]
    keys += [(name, PAPER_WINDOW) for name in PAPER]
    keys += [(name, 1) for name in result.more if (name, 1) not in keys]
    best = result.closest_of_paper
    return keys + ([best] if best and best not in keys else [])


def _estimator_row(result: EstimatorsResult, name: str, window: int) -> EstimatorRow:
    score, cost = result.scores[name, window], result.timing.contenders[name].contact
    return EstimatorRow(
        estimator=name,
        window=window,
        ms=(cost.p50_ms, cost.p99_ms),
        mare=score.mare,
        mare_b=score.mare_b,
        held_deg=score.mare_held and score.mare_held.mean_deg,
        elongated_deg=score.mare_elongated and score.mare_elongated.mean_deg,
        worst=score.worst_text,
        answered=score.answered,
        within_two_sigma=score.within_two_sigma,
        onset_ms=None if score.onset.error_s is None else 1e3 * score.onset.error_s,
        event_within=score.event and score.event.within,
        false_events=score.event and score.event.false_alarms,
    )


def _against_paper(result: EstimatorsResult) -> str:
    """Return a sentence that compares `slip` with the paper's method that is best on these lifts."""
    best, ours = result.closest_of_paper, result.scores[DEFAULT_ESTIMATOR, 1].mare
    theirs = result.scores[best].mare if best else None
    if best is None or ours is None or theirs is None:
        return "None of the paper's methods gave an answer."
    return (
        f"The closest of the paper's methods on these lifts is {best[0]} with window {best[1]}: "
        f"{theirs.mean_deg:.2f} degrees, {theirs.mean_deg / ours.mean_deg:.1f} times ours."
    )


def _stress_cell(row: StressRow | None) -> str:
    if row is None:
        return NONE
    if row.refused:
        return f"refused {1.0 - row.score.answered:.0%}"
    mean = _mean(row.score.mare)
    return mean if row.score.answered >= 0.995 else f"{mean} ({row.score.answered:.0%})"


def _mean(mare: Mare | None) -> str:
    return NONE if mare is None else f"{mare.mean_deg:.2f}"


def _share(value: float | None) -> str:
    return NONE if value is None else f"{value:.1%}"
