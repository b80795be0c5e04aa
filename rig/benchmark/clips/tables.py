"""The tables of `rig benchmark clips`: for the terminal, the page and the README."""

from collections.abc import Sequence

from drivers.errors import counted
from rig.benchmark.clips.benchmark import ClipsResult
from rig.benchmark.clips.scores import ClipScore
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.estimators.tables import limit_table as kept_table
from rig.benchmark.harness import machine
from rig.benchmark.measured import Measured
from rig.benchmark.readme import markdown_table

NAME = "clips"
"""Of its section in a README."""
SCORE_COLUMNS = (
    "labels", "within 3 deg", "within 3 deg or 2 label sigmas", "mean, up to 30 deg", "mean, all",
    "median, up to 30 deg", "median, all", "useful", "within 2 sigma", "confidently wrong", "false rest",
    "ms per frame: median, 99 %",
)  # fmt: skip
CONTACT_COLUMNS = ("empty reported as contact", "held reported as contact")
"""Shown if a clip has a file `contacts.csv`."""
NONE = "-"
EVERY = "all"


def overall_table(result: ClipsResult) -> BenchmarkTable:
    """Return a row per estimator and group, all clips first."""
    rows = [
        (of.name if group == EVERY else "", group, *_cells(found, result))
        for of in result.estimators
        for group, found in {EVERY: of.overall, **_groups(of.groups)}.items()
    ]
    columns = ("estimator", "clips", *_columns(result))
    return BenchmarkTable("Hand-measured angles, errors in degrees", columns, rows)


def clip_table(result: ClipsResult) -> BenchmarkTable:
    """Return a row per clip for the first estimator, worst first."""
    first = result.estimators[0]
    worst = sorted(first.runs, key=lambda run: -run.score.mean_deg)
    rows = [(run.clip.name, run.clip.group, *_cells(run.score, result)) for run in worst]
    return BenchmarkTable(f"'{first.name}' by clip, worst first", ("clip", "group", *_columns(result)), rows)


def limit_table(result: ClipsResult) -> BenchmarkTable:
    """Return every limit, what was measured and whether it was kept."""
    return kept_table(result.limits, f"'{result.estimators[0].name}', {result.group or 'all clips'}")


def readme_section(result: ClipsResult) -> str:
    """Return the README's section in Markdown, without its markers."""
    table, clips = overall_table(result), result.estimators[0].runs
    labels, of = sum(len(run.labels) for run in clips), machine()
    head = f"{counted(len(clips), 'clip')}, {counted(labels, 'label')}, "
    head += f"{of['processor']}, {of['cores']} cores, one thread. Errors in degrees."
    return "\n".join(
        [head, "", markdown_table(table.columns, table.rows), "", verdict(result.limits)]
    ).rstrip()


def verdict(limits: Sequence[Measured]) -> str:
    """Say which limits were missed; "" without limits."""
    if not limits:
        return ""
    missed = [f"{limit.name} {_value(limit)}, asked {limit.asked}" for limit in limits if not limit.met]
    return f"Limits missed: {'; '.join(missed)}." if missed else "All limits were kept."


def _groups(groups: dict[str, ClipScore]) -> dict[str, ClipScore]:
    """Return the groups; one group is all clips and says nothing."""
    return groups if len(groups) > 1 else {}


def _has_contacts(result: ClipsResult) -> bool:
    return any(run.contacts for run in result.estimators[0].runs)


def _columns(result: ClipsResult) -> tuple[str, ...]:
    return SCORE_COLUMNS + CONTACT_COLUMNS if _has_contacts(result) else SCORE_COLUMNS


def _cells(score: ClipScore, result: ClipsResult) -> tuple[str, ...]:
    contacts = (_share(score.empty_as_contact, 1), _share(score.held_as_contact, 1))
    return (
        str(score.labels),
        _share(score.within_3),
        _share(score.within),
        _number(score.mean_small_deg),
        _number(score.mean_deg),
        _number(score.median_small_deg),
        _number(score.median_deg),
        _share(score.useful),
        _share(score.two_sigma),
        _share(score.confidently_wrong),
        _share(score.false_rest),
        f"{score.median_ms:.2f}, {score.p99_ms:.2f}",
        *(contacts if _has_contacts(result) else ()),
    )


def _value(limit: Measured) -> str:
    return NONE if limit.value is None else f"{limit.value:.3g}"


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f}"


def _share(value: float | None, digits: int = 0) -> str:
    return NONE if value is None else f"{value:.{digits}%}"
