"""Progress and tables for people."""

import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from statistics import median
from typing import Generic, Self, TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from drivers.errors import counted
from rig.cli.fitting import table_console
from rig.live.console import PlainConsole
from rig.live.screen import begin_phase, shown
from rig.live.time_left import TimeLeft, left_text
from rig.results.metrics import HEADING, mare_text
from rig.results.summary import ADVICE, ObjectSummary, ReactingSummary, TrialSummary, main_refusal
from rig.results.table import TableLift
from rig.sessions.records import FailedLift, FinishedLift, LiftRow

Row = TypeVar("Row")


class WorkProgress:
    """A progress bar on a terminal, a plain line per finished piece of work elsewhere."""

    def __init__(self, total: int, what: str) -> None:
        console = PlainConsole(stderr=True)
        self._what, self._plain = what, not console.is_terminal
        self._bar = Progress(
            TextColumn(what),
            BarColumn(),
            MofNCompleteColumn(),
            _TimeLeftColumn(self._left_s),
            console=console,
            disable=self._plain,
        )
        self._task = self._bar.add_task(what, total=total)
        self._time_left = TimeLeft(total)
        self._shown = ExitStack()

    def __enter__(self) -> Self:
        if self._plain:
            begin_phase(f"{self._what}: the first is under way")
        else:
            self._shown.enter_context(shown(self._bar.live))
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.close()

    def show(self, done: int, total: int, note: str) -> None:
        """Show how far it is, and what the last piece of work gave."""
        if self._plain:
            print(f"{done}/{total} {note}", file=sys.stderr, flush=True)
        else:
            self._time_left.piece_done(done, total)
            self._bar.update(self._task, completed=done, total=total)
            self._bar.console.print(f"{done}/{total} {note}", highlight=False)

    def _left_s(self) -> float | None:
        return self._time_left.counting_down()


class _TimeLeftColumn(ProgressColumn):
    """The time left, asked for at each redraw."""

    def __init__(self, left_s: Callable[[], float | None]) -> None:
        super().__init__()
        self._left_s = left_s

    def render(self, task: Task) -> Text:
        """Write it."""
        return Text(left_text(self._left_s()))


class OneMessage(Generic[Row]):
    """Says what came of an attempt; of the same fault again only that it is the same.

    note: what came of it, in a few words, with the fault. fault: what ended it, None where it counts.
    """

    def __init__(self, note: Callable[[Row], str], fault: Callable[[Row], str | None]) -> None:
        self._note, self._fault = note, fault
        self._last: str | None = None

    def __call__(self, row: Row) -> str:
        """Say it."""
        fault, last = self._fault(row), self._last
        self._last = fault
        text = self._note(row)
        return text if fault is None or fault != last else text.replace(fault, "the same fault again")


def lift_fault(row: LiftRow) -> str | None:
    """What ended a lift."""
    return row.fault if isinstance(row, FailedLift) else None


class TrialProgress(WorkProgress):
    """Progress of a trial: what came of each lift."""

    def __init__(self, total: int) -> None:
        super().__init__(total, "lifts")

    def __call__(self, done: int, total: int, row: LiftRow) -> None:
        """Show one lift."""
        self.show(done, total, lift_note(row))


def lift_note(row: LiftRow | TableLift) -> str:
    """Say in a few words what came of a lift."""
    head = f"{row.object} {row.name} lift {row.lift}: {row.outcome}"
    if isinstance(row, FailedLift):
        return f"{head}: {row.fault}"
    turn = row.final_truth_deg
    parts = [] if turn is None else [f"turned {turn:+.1f} deg"]
    parts.append(_without_error(row) if row.re is None else f"mean error {row.re.mean_deg:.2f} deg")
    if isinstance(row, FinishedLift):
        if row.reactions:
            parts.append(counted(len(row.reactions), "reaction"))
        amiss = (row.marker_distance, row.estimator_faults)
        parts += [f"WARNING: {what}" for what in amiss if what]
    return f"{head}, {', '.join(parts)}"


def _without_error(row: FinishedLift | TableLift) -> str:
    """Say why a lift has no error. A results table does not hold the states of the frames."""
    if row.answered:
        return "no error: the angle of the markers is missing wherever the estimator answered"
    if isinstance(row, TableLift):
        return "no answer"
    why = main_refusal([row.states])
    return f"no answer, most frames are '{why}': {ADVICE[why]}"


def trial_table(summary: TrialSummary, simulated: str, wall_s: float, to_stderr: bool = False) -> None:
    """Print the paper's table per object and the trial's figures."""
    console = table_console(to_stderr)
    console.print(object_table(summary, simulated, summary.reacting.kind if summary.reacting else "none"))
    console.print(
        f"{simulated}MARE over phase B {mare_text(summary.mare_b)}; paper, on its real bench: 1.85 ± 0.96; "
        f"refused frames held {mare_text(summary.mare_held)}"
    )
    console.print(turn_distribution(summary))
    if summary.reacting:
        console.print(reaction_text(summary.reacting))
    console.print(f"{wall_s:.1f} s for {summary.bench_s:.1f} s of {simulated.lower()}bench time")


def console_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1, title: str | None = None
) -> Table:
    """Return a table whose first columns stand on the left, the others on the right. left: how many."""
    table = Table(title=title)
    for place, column in enumerate(columns):
        table.add_column(column, justify="left" if place < left else "right")
    for row in rows:
        table.add_row(*row)
    return table


def object_table(summary: TrialSummary, simulated: str, react: str = "none") -> Table:
    """Return the paper's table per object. react: what was done about slip."""
    reacting = "" if react == "none" else f"; reaction to slip: {react}"
    title = f"{simulated}rotational error per object, degrees: {HEADING}{reacting}"
    table = Table(title=title)
    for heading in ("object", "lifts", "outcomes", "true turn", "phase B", "phases B and C", "answered"):
        table.add_column(heading, justify="left" if heading in ("object", "outcomes") else "right")
    for row in summary.objects:
        table.add_row(*_object_cells(row))
    table.add_section()
    table.add_row(
        "all", str(summary.lifts_accepted), "", "",
        mare_text(summary.mare_b), mare_text(summary.mare), f"{summary.answered:.1%}",
    )  # fmt: skip
    return table


def reaction_text(reacting: ReactingSummary) -> str:
    """Say what reactions to slip were worth, and that their lifts' errors stand apart."""
    added = reacting.added_counts
    grip = f", grip added {median(added):g} steps in the middle, {max(added)} at most" if added else ""
    turn = f", end turn {median(reacting.turns_deg):.1f} deg in the middle" if reacting.turns_deg else ""
    return (
        f"reaction to slip '{reacting.kind}': {reacting.caught} of {counted(reacting.lifts, 'lift')} caught, "
        f"{counted(reacting.reactions, 'reaction')}, {reacting.early} of them to less than half a degree"
        f"{grip}{turn}; "
        "these lifts turn less, so their MARE stands apart from that of lifts without reaction"
    )


def turn_distribution(summary: TrialSummary) -> str:
    """Say how far the lifts turned, in steps of 5 degrees of the true angle, and which way."""
    sizes = [abs(turn) for turn in summary.turns_deg]
    top = max(int(max(sizes, default=0.0) // 5) + 1, 1)
    counts = [sum(5 * i <= size < 5 * (i + 1) for size in sizes) for i in range(top)]
    steps = ", ".join(f"{5 * i}-{5 * i + 5}: {count}" for i, count in enumerate(counts))
    left = sum(turn > 0 for turn in summary.turns_deg)
    at_least_5 = sum(size >= 5.0 for size in sizes)
    return (
        f"lifts by true turn, degrees: {steps} ({at_least_5} of {len(sizes)} turned by 5 or more; "
        f"{left} counter-clockwise, {len(sizes) - left} clockwise)"
    )


def summary_json(summary: TrialSummary) -> dict[str, object]:
    """Return the trial's figures under the contract's names."""
    reacting = summary.reacting
    reacted = {} if reacting is None else {"react": reacting.kind, "caught": reacting.caught}
    return {
        **reacted,
        "lifts_accepted": summary.lifts_accepted,
        "lifts_refused": summary.lifts_accepted - (summary.mare.lifts if summary.mare else 0),
        "mare_deg": summary.mare and summary.mare.mean_deg,
        "mare_std_deg": summary.mare and summary.mare.std_deg,
        "mare_interval_deg": summary.mare and summary.mare.ends_deg,
        "mare_b_deg": summary.mare_b and summary.mare_b.mean_deg,
        "mare_held_deg": summary.mare_held and summary.mare_held.mean_deg,
        "answered": summary.answered,
        "bench_s": round(summary.bench_s, 3),
    }


def _object_cells(row: ObjectSummary) -> list[str]:
    outcomes = ", ".join(f"{count} {name}" for name, count in row.outcomes.items())
    return [
        f"{row.object_id} {row.name}", str(row.lifts), outcomes, row.turn_text,
        mare_text(row.mare_b), mare_text(row.mare), f"{row.answered:.1%}",
    ]  # fmt: skip
