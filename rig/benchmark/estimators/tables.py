"""The benchmark's tables as rows of text: for the terminal, the page and the README."""

from drivers.errors import counted
from rig.benchmark.estimators.benchmark import BenchmarkResult
from rig.benchmark.estimators.contenders import ALIGNMENTS, NO_SKIP, PAPER
from rig.benchmark.estimators.stress import NAMES, StressRow
from rig.benchmark.estimators.timing import Spread
from rig.benchmark.harness import Table, machine
from rig.results.metrics import HEADING, mare_text
from rig.tactile.estimators import DEFAULT_ESTIMATOR, PAPER_WINDOW

NAME = "estimators"
"""Of its section in a README."""
ESTIMATOR_COLUMNS = (
    "estimator", "window", "ms per frame: median, 99 %", "MARE, B and C", "MARE, B", "refused held",
    "elongated", "worst lift", "answered", "within 2 sigma", "onset error, ms", "event within 50 ms",
    "false events",
)  # fmt: skip
README_COLUMNS = ESTIMATOR_COLUMNS[:10]
TIME_COLUMNS = ("estimator", "stage", "median, ms", "90 %", "95 %", "99 %", "frames")
NONE = "-"


def estimator_table(result: BenchmarkResult, windows: bool = False) -> Table:
    """One row per estimator with its usual window and the paper's best, or with every window."""
    keys = list(result.scores) if windows else _usual(result)
    title = (
        f"{_simulated(result)}rotational error in degrees over {counted(result.lifts, 'lift')}, and run time"
    )
    return Table(title, ESTIMATOR_COLUMNS, [_estimator_row(result, *key) for key in keys])


def time_table(result: BenchmarkResult) -> Table:
    """Percentiles of run time per stage, on frames with contact, and of the published second stage."""
    rows = []
    for name, timing in result.timing.contenders.items():
        rows.append((name, "frame in to angle out", *_times(timing.contact)))
        rows += [("", stage, *_times(spread)) for stage, spread in timing.stages.items()]
    published = result.timing.published
    rows.append(("published second stage", "mask to angle, full picture", *_times(published.stage)))
    rows.append(("", "thinning of the 256 x 320 picture", *_times(published.thinning)))
    rows.append(("", "mask to angle, cropped picture", *_times(published.cropped)))
    width, height = result.timing.size_px
    return Table(f"Run time, one thread, {width} x {height} px, frames with contact", TIME_COLUMNS, rows)


def stress_table(result: BenchmarkResult) -> Table:
    """MARE per condition and estimator; a share in brackets where not every frame was answered."""
    by = {(row.condition, row.estimator): row for row in result.stress}
    conditions = dict.fromkeys((row.group, row.condition) for row in result.stress)
    names = tuple(dict.fromkeys((*NAMES, *(row.estimator for row in result.stress))))
    rows = [
        (group, condition, *(_stress_cell(by.get((condition, name))) for name in names),
         _share(_within(by.get((condition, DEFAULT_ESTIMATOR)))))
        for group, condition in conditions
    ]  # fmt: skip
    title = "SIMULATED clips with known angles: mean error in degrees (share of frames answered, if not all)"
    return Table(title, ("group", "condition", *names, f"{DEFAULT_ESTIMATOR} within 2 sigma"), rows)


def notes(result: BenchmarkResult) -> list[str]:
    """Return what else was measured, a sentence each."""
    threads, saved = result.timing.threads, result.timing.skip_saves
    shares = ", ".join(f"{stage} {share:.0%}" for stage, share in result.skipped.items())
    return [
        f"Skipping saves {saved:.0%} of the time of --no-skip; the angles differ by at most "
        f"{result.skip_gap_deg:.3g} degrees, {result.skip_apart} frames are answered by one of them only. "
        f"Left out, of all frames: {shares or 'nothing'}.",
        f"One OpenCV thread {threads.one_ms:.2f} ms, two {threads.two_ms:.2f} ms (median of "
        f"{threads.frames} frames); the angles differ by at most {threads.gap_deg:.3g} degrees.",
        _against_paper(result),
        "Onsets found afterwards: " + "; ".join(_onset_note(result, key) for key in _usual(result)) + ".",
        "The published methods know no sign: against the size of the true angle alone their MARE is "
        + ", ".join(_unsigned(result, key) for key in _usual(result) if "published" in key[0])
        + " degrees.",
    ]


def readme_section(result: BenchmarkResult) -> str:
    """Return the README's section in Markdown, without its markers."""
    rows = [
        _estimator_row(result, *key)[: len(README_COLUMNS)] for key in _usual(result) if key[0] != NO_SKIP
    ]
    missed = [limit.name for limit in result.limits if not limit.met]
    of = machine()
    return "\n".join(
        [
            f"{_simulated(result)}{counted(result.lifts, 'lift')}, seed {result.settings.seed}, "
            f"{of['processor']}, {of['cores']} cores, one thread. Errors in degrees, {HEADING}.",
            "",
            Table("", README_COLUMNS, rows).markdown(),
            "",
            f"Limits missed: {'; '.join(missed)}." if missed else "All limits were kept.",
        ]
    )


def _usual(result: BenchmarkResult) -> list[tuple[str, int]]:
    """The usual window of each estimator, and the paper's best method where that is another."""
    keys = [(DEFAULT_ESTIMATOR, 1), (NO_SKIP, 1), *((name, 1) for name in ALIGNMENTS)]
    keys += [(name, PAPER_WINDOW) for name in PAPER]
    keys += [(name, 1) for name in result.settings.more if (name, 1) not in keys]
    best = result.closest_of_paper
    return keys + ([best] if best and best not in keys else [])


def _estimator_row(result: BenchmarkResult, name: str, window: int) -> tuple[str, ...]:
    score, cost = result.scores[name, window], result.timing.contenders[name].contact
    onset, event = score.onset, score.event
    return (
        name,
        NONE if window == 1 else str(window),
        f"{cost.p50_ms:.2f}, {cost.p99_ms:.2f}",
        mare_text(score.mare),
        mare_text(score.mare_b),
        _number(score.mare_held.mean_deg if score.mare_held else None),
        _number(score.mare_elongated.mean_deg if score.mare_elongated else None),
        NONE if score.worst_deg is None else f"{score.worst_deg:.2f} ({score.worst})",
        f"{score.answered:.1%}",
        _share(score.within_two_sigma),
        NONE if onset.error_s is None else f"{1e3 * onset.error_s:.0f}",
        _share(event.within if event else None),
        NONE if event is None else str(event.false_alarms),
    )


def _against_paper(result: BenchmarkResult) -> str:
    """Compare with whichever of the paper's methods does best here, not only with the one it prefers."""
    best, ours = result.closest_of_paper, result.scores[DEFAULT_ESTIMATOR, 1].mare
    theirs = result.scores[best].mare if best else None
    if best is None or ours is None or theirs is None:
        return "None of the paper's methods gave an answer."
    return (
        f"The closest of the paper's methods on these lifts is {best[0]} with window {best[1]}: "
        f"{theirs.mean_deg:.2f} degrees, {theirs.mean_deg / ours.mean_deg:.1f} times ours."
    )


def _onset_note(result: BenchmarkResult, key: tuple[str, int]) -> str:
    onset = result.scores[key].onset
    return f"{key[0]} {_share(onset.within)} of {onset.true} within 50 ms, {onset.missed} missed"


def _unsigned(result: BenchmarkResult, key: tuple[str, int]) -> str:
    mare = result.scores[key].mare_unsigned
    return f"{key[0]} {_number(mare.mean_deg if mare else None)}"


def _stress_cell(row: StressRow | None) -> str:
    if row is None:
        return NONE
    if row.refused:
        return f"refused {1.0 - row.score.answered:.0%}"
    mean = _number(row.score.mare.mean_deg if row.score.mare else None)
    return mean if row.score.answered >= 0.995 else f"{mean} ({row.score.answered:.0%})"


def _within(row: StressRow | None) -> float | None:
    return row.score.within_two_sigma if row else None


def _times(spread: Spread) -> tuple[str, ...]:
    values = (spread.p50_ms, spread.p90_ms, spread.p95_ms, spread.p99_ms)
    return (*(f"{value:.2f}" for value in values), str(spread.count))


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f}"


def _share(value: float | None) -> str:
    return NONE if value is None else f"{value:.1%}"


def _simulated(result: BenchmarkResult) -> str:
    return "SIMULATED " if result.simulated else ""
