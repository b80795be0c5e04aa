"""Time from a slip to the command and to standstill: lifts over the wire protocol, in real time."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S
from protocols.observer import ReactionStep
from protocols.reaction import ReactionKind
from rig.bench.fakes_process import started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.measured import Measured, at_most, informative
from rig.config import load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.reading import recorded_reactions
from rig.sessions.records import LiftRow
from rig.sessions.rows import read_finished_lifts

OBJECT = "t1"
"""The wrench: it slips at any grip, so that each of its lifts has several reactions."""
MOST_COMMAND_MS = 20.0
MS_PER_S = 1e3
ARM = (ReactionStep.STOP, ReactionStep.STANDS)
FINGERS = (ReactionStep.CLOSE, ReactionStep.CLOSED)


def times_over_wire(
    settings: TrialSettings, lifts: int, progress: Callable[[int, int, str], None] = lambda *_: None
) -> list[Measured]:
    """Carry out lifts that react as soon as a slip is detected; return how long that took.

    SIMULATED devices, in real time. Raises what `run_trial` raises.
    """

    def show(done: int, total: int, row: LiftRow) -> None:
        progress(done, total, f"behind wires, {row.object}/{row.lift}")

    with (
        tempfile.TemporaryDirectory() as folder,
        started_fakes(load_bench("wire")) as config,
        closing(StandingBench(config, ConsoleOperator(lambda _: True), "")) as benches,
    ):
        session = Path(folder) / "session"
        trial = replace(settings, bench=config, slip=replace(settings.slip, max_turn_deg=None))
        run_trial(session, trial, [OBJECT], lifts, benches=benches, progress=show)
        return times_of(session, settings.react)


def times_of(session: Path, react: ReactionKind) -> list[Measured]:
    """Return the times of a session's reactions: from capture to command, and then to standstill."""
    rows = read_finished_lifts(session)
    reactions = [r for row in rows for r in row.reactions or ()]
    late_ms = [MS_PER_S * (r.command_s - r.event_s) for r in reactions if r.event_s is not None]
    steps = [recorded_reactions(session / row.recording) for row in rows]
    moved = {"arm": ARM, "fingers": FINGERS} if react is ReactionKind.TIGHTEN else {"arm": ARM}
    took_ms = {who: [ms for lift in steps for ms in _took_ms(lift, both)] for who, both in moved.items()}
    return [
        at_most(
            f"behind wires, capture of the frame that told to command, 99 % of {len(late_ms)}, ms",
            np.percentile(late_ms, 99) if late_ms else None,
            MOST_COMMAND_MS,
        ),
        *(
            informative(f"behind wires, command to standstill of {who}, {of} %, ms", np.percentile(ms, of))
            for who, ms in took_ms.items()
            if ms
            for of in (50, 99)
        ),
    ]


def _took_ms(
    steps: Sequence[tuple[ReactionStep, int]], both: tuple[ReactionStep, ReactionStep]
) -> Iterator[float]:
    """Yield the time between two steps, wherever the second follows the first directly."""
    for (first, began_ns), (second, ended_ns) in pairwise(steps):
        if (first, second) == both:
            yield MS_PER_S * (ended_ns - began_ns) / NS_PER_S
