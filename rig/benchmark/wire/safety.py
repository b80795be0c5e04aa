"""`rig benchmark safety`: a trial at a bench that counts as real, and something happens to it at any moment.

The trial is a program of its own, as a person starts it with `--yes` and nobody at a terminal. What it
does is held against the track of the simulated world. Then somebody puts the bench in order.
"""

import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.errors import DeviceError, InputError, RigError
from protocols.readiness import make_ready
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.wire.moments import Stage, wait_for
from rig.benchmark.wire.real_bench import as_real
from rig.benchmark.wire.safety_events import BY_NAME, Event, PlannedRun
from rig.benchmark.wire.safety_judge import judge
from rig.benchmark.wire.safety_program import TrialProgram, own_state, strike, switch_on
from rig.benchmark.wire.tries import tried
from rig.benchmark.wire.true_track import TrueState, read_track
from rig.config import BenchConfig, load_bench
from rig.config.write import write_bench
from rig.sessions.codec import Codec, json_line
from rig.sessions.files import append_line
from rig.sessions.records import finished
from rig.sessions.rows import read_lifts, read_rows, read_usable_lifts

OBJECT = "t1"
RUNS = "runs.jsonl"
STOPPED_S = 1.5
"""How long a stopped program stays stopped before it goes on."""
END_S = 90.0
SETTLE_S = 0.5
"""After the end of the program: what a killed one left going ends too."""


@dataclass(frozen=True, slots=True)
class SafetyRun:
    """What came of a run.

    still_s, way_mm: from the event to the first standstill. unasked: see `Judged`. kept: whether the lift
    finished before is whole on disk. ended: the program's exit code, negative for a signal, and said: its
    last line. ready: why the bench could not be put in order, where that is so.
    """

    number: int
    event: str
    stage: Stage
    still_s: float
    way_mm: float
    dropped: bool
    unasked: str
    kept: bool
    ended: int
    said: str
    ready: str = ""

    @property
    def ended_well(self) -> bool:
        """Whether the program ended with a line and a code that say why; killed, it says nothing."""
        if BY_NAME[self.event].signals == (signal.SIGKILL,):
            return self.ended == -signal.SIGKILL
        return self.ended in (0, 1, 2, 3) and self.said.startswith("rig: ") == bool(self.ended)


CODEC: Codec[SafetyRun] = Codec(SafetyRun)


def run_safety(
    folder: Path,
    plan: Sequence[PlannedRun],
    resume: bool = False,
    progress: Callable[[SafetyRun], None] = lambda run: None,
    bench: BenchConfig | None = None,
) -> list[SafetyRun]:
    """Carry out the runs that are not in the folder yet, each kept at once; return all.

    bench: the bench behind wires, by default `wire`. Raises `InputError` for a folder that has runs and is
    not to be resumed, `DeviceError` where a program does not get to its moment.
    """
    folder.mkdir(parents=True, exist_ok=True)
    runs = read_rows(folder / RUNS, CODEC)
    if runs and not resume:
        raise InputError(f"{folder}: has {len(runs)} runs; go on with --resume, or give another folder")
    left = [planned for planned in plan if planned.number not in {run.number for run in runs}]
    if left:
        with own_state(folder / "state"), started_fakes(bench or load_bench("wire")) as config:
            place = _Place(folder, config)
            tried(place.finish_a_lift, place.put_in_order)
            for planned in left:
                run = tried(partial(place.run, planned), place.put_in_order)
                append_line(folder / RUNS, json_line(run))
                runs.append(run)
                progress(run)
    numbers = {planned.number for planned in plan}
    return sorted((run for run in runs if run.number in numbers), key=lambda run: run.number)


class _Place:
    """A served bench, its two files, and a session with one finished lift."""

    def __init__(self, folder: Path, config: BenchConfig) -> None:
        self._config, self._control = config, fakes_control(config)
        self._grasp_m = config.table.position_m[2]
        self._real = folder / "real.toml"
        self._one, self._session = folder / "one", folder / "session"
        write_bench(self._real, as_real(config))

    def finish_a_lift(self) -> None:
        """Make the session that every run goes on with: one lift of two is done."""
        shutil.rmtree(self._one, ignore_errors=True)
        with self._program(self._one) as program:
            while not finished(read_lifts(self._one)):
                program.check()
                time.sleep(0.1)
            program.send(signal.SIGINT)
            program.wait(END_S)
        if reason := self.put_in_order():
            raise DeviceError(f"safety: the bench cannot be put in order: {reason}")

    def run(self, planned: PlannedRun) -> SafetyRun:
        """Start the second lift, let it happen, and judge."""
        shutil.rmtree(self._session, ignore_errors=True)
        shutil.copytree(self._one, self._session)
        event = planned.event
        with self._program(self._session) as program:
            stage = wait_for(planned.moment, self._grasp_m, self._world, program.over)
            if stage is None:
                raise DeviceError(f"safety: run {planned.number} ended too early: {program.said()}")
            event_ns = strike(event, program, self._control.call)
            track = self._end(event, program, event_ns)
            judged = judge(event, stage, track, event_ns, self._grasp_m)
            ended, said = program.code, program.said()
        return SafetyRun(
            number=planned.number,
            event=event.name,
            stage=stage,
            still_s=round(judged.stop.after_s, 4),
            way_mm=round(1e3 * judged.stop.way_m, 2),
            dropped=judged.dropped,
            unasked=judged.unasked,
            kept=self._kept(),
            ended=ended,
            said=said,
            ready=self.put_in_order(),
        )

    def _end(self, event: Event, program: TrialProgram, since_ns: int) -> list[TrueState]:
        """Wait for the end of the program; one that is stopped is judged by then, and goes on after it."""
        if signal.SIGSTOP not in event.signals:
            program.wait(END_S)
            time.sleep(SETTLE_S)
            return read_track(self._control.call, since_ns)
        time.sleep(STOPPED_S)
        track = read_track(self._control.call, since_ns)
        program.send(signal.SIGCONT)
        program.wait(END_S)
        return track

    def _world(self) -> dict[str, object]:
        return self._control.call("world")

    @contextmanager
    def _program(self, session: Path) -> Iterator[TrialProgram]:
        self._control.call("place", object=OBJECT, seed=1)
        with closing(TrialProgram(self._real, session, OBJECT)) as program:
            yield program

    def _kept(self) -> bool:
        """Whether the first lift can be read, its recording by its checksums."""
        try:
            usable = read_usable_lifts(self._session, checked=True)
        except RigError:
            return False
        return any(row.lift == 1 for row in usable.lifts)

    def put_in_order(self) -> str:
        """Do what a person would who agrees to what the rig asks. Returns why it cannot be done, if so."""
        self._control.call("fault", device="all", kind="clear")
        switch_on(self._config.arm.host or "")
        benches = StandingBench(self._config, ConsoleOperator(lambda _: True), "")
        try:
            with closing(benches), benches.for_lift(1, "in order") as (bench, operator):
                make_ready(bench, operator, after_fault=True)
        except (DeviceError, InputError) as error:
            return f"{type(error).__name__}: {error}"
        return ""
