"""`rig benchmark safety`: an event at a random moment of a lift, on a bench that counts as real.

The trial runs as a separate program with `--yes` and without a terminal. After each run the bench is put in
order, as a person would do, and the trial continues with `--resume`: the next lift has to run.
"""

import math
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from drivers.errors import DeviceError, InputError, RigError
from protocols.readiness import make_ready
from rig.benchmark.harness import Report, Run, Study, Table
from rig.benchmark.measured import NONE, Measured, at_most, informative
from rig.benchmark.wire import campaign
from rig.benchmark.wire.campaign import LASTS_S, After, Event, PlannedRun, Stage, WireBench, fault
from rig.config import BenchConfig, load_bench
from rig.config.write import write_bench
from rig.declared import option
from rig.sessions.records import accepted_lifts
from rig.sessions.rows import read_lifts, read_usable_lifts

OBJECT = "t1"
FEEDER = "magazine"  # "machine" that places the object before each lift: the benchmark
STATE = "XDG_STATE_HOME"
STOPPED_S = 1.5  # time for which a stopped program stays stopped
END_S = 90.0
SETTLE_S = 0.5  # time after the end of the program within which motions of a killed program end
APPROACH_MM = 20.0  # longest way from an event in the approach to standstill


def _signal(name: str, number: signal.Signals, after: After = After.SAFE_END, times: int = 1) -> Event:
    return Event(name, after, (number,) * times)


EVENTS = (
    _signal("Ctrl-C", signal.SIGINT),
    _signal("Ctrl-C twice", signal.SIGINT, After.STAYS, times=2),
    _signal("SIGTERM", signal.SIGTERM),
    _signal("SIGHUP", signal.SIGHUP),
    _signal("SIGQUIT", signal.SIGQUIT),
    _signal("kill -9", signal.SIGKILL, After.STAYS),
    _signal("SIGSTOP", signal.SIGSTOP, After.STAYS),
    Event("disk full", disk_full=True),
    fault("protective stop", "arm", "protective_stop", after=After.STAYS, named="protective stop"),
    fault("emergency stop", "arm", "emergency_stop", after=After.STAYS),
    fault("arm program killed", "arm", "program_killed", named="program"),
    fault("arm state frozen", "arm", "stream_frozen"),
    fault("arm state repeats itself", "arm", "stream_frozen", repeat=True),
    fault("arm connections lost", "arm", "socket_dropped"),
    fault("arm silent", "arm", "silent"),
    fault("remote control off", "arm", "remote_control_off", "socket_dropped"),
    fault("recipe refused", "arm", "recipe_refused", "socket_dropped"),
    fault("gripper lost", "gripper", "disconnect"),
    fault("gripper silent", "gripper", "silent"),
    fault("gripper sends garbage", "gripper", "garbage"),
    fault("gripper without power", "gripper", "power_lost"),
    fault("gripper fault 0x0D", "gripper", "fault", named="0x0D", code=0x0D),
    fault("fingers blocked", "gripper", "blocked", after=After.FINGERS),
    fault("fingers stuck", "gripper", "stuck", after=After.FINGERS),
    fault("false success", "gripper", "false_success", after=After.FINGERS),
    fault("fingers overshoot", "gripper", "overshoot", after=After.FINGERS),
    fault("fingers drift open", "gripper", "drift", named="without a command"),
    fault("fingertip lost", "SIM-D0001", "disconnect"),
    fault("fingertip frozen", "SIM-D0001", "freeze"),
    fault("fingertip without frames", "SIM-D0001", "drop"),
    fault("green frames", "SIM-D0001", "green"),
    fault("shifted frames", "SIM-D0001", "shift"),
    fault("truncated frames", "SIM-D0001", "truncate"),
    fault("camera lost", "camera", "disconnect", named="SIM-C0001"),
    fault("camera frozen", "camera", "freeze", named="SIM-C0001"),
)
"""Remote control and recipe only matter when the rig connects, so these events also cut the connections."""
BY_NAME = {event.name: event for event in EVENTS}


def plan_runs(seed: int, full: bool, events: Sequence[Event] = EVENTS) -> list[PlannedRun]:
    """Draw the runs of a benchmark: each event once in a random stage or, if `full`, once in every stage."""
    rng = random.Random(seed)  # noqa: S311 - moments, no secrets
    if full:
        cells = [(event, stage) for event in events for stage in Stage]
    else:
        stages = ([*Stage] * math.ceil(len(events) / len(Stage)))[: len(events)]
        rng.shuffle(stages)
        cells = list(zip(events, stages, strict=True))
    rng.shuffle(cells)
    return [
        PlannedRun(number, event, stage, rng.uniform(0.0, LASTS_S[stage]))
        for number, (event, stage) in enumerate(cells, start=1)
    ]


@dataclass(frozen=True, slots=True)
class SafetyRun:
    """Result of an event. still_s, way_mm: from the event to the first standstill."""

    number: int
    event: str
    stage: Stage
    still_s: float
    way_mm: float
    dropped: bool
    unasked: str  # see `campaign.find_unasked_motion`
    kept: bool  # whether the lift finished before is whole on disk
    ended: int  # the program's exit code, negative for a signal
    said: str  # its last line
    fault: str = ""  # of the lift, as stored in the session; "" without one
    not_continued: str = ""  # why the next lift did not run, if so

    @property
    def ended_well(self) -> bool:
        """Whether the program ended with a line and a code for the reason; if killed, it prints nothing."""
        if BY_NAME[self.event].signals == (signal.SIGKILL,):
            return self.ended == -signal.SIGKILL
        return self.ended in (0, 1, 2, 3) and self.said.startswith("rig: ") == bool(self.ended)

    @property
    def noticed(self) -> bool:
        """Whether a fault in mid-lift ended the lift, with the device or the reason in its text."""
        event = BY_NAME[self.event]
        return not event.faults or self.stage is not Stage.LIFT or event.named.lower() in self.fault.lower()

    def __str__(self) -> str:
        stood = f"stood after {self.still_s:.2f} s, {self.way_mm:.1f} mm"
        wrong = {
            "DROPPED": self.dropped,
            f"UNASKED: {self.unasked}": self.unasked,
            "FINISHED LIFT LOST": not self.kept,
            f"ended with {self.ended}: {self.said}": not self.ended_well,
            f"not noticed: {self.fault or 'no fault'}": not self.noticed,
            f"not continued: {self.not_continued}": self.not_continued,
        }
        found = [text for text, so in wrong.items() if so]
        return "; ".join([f"{self.event}, {self.stage}: {stood}", *found])


def run_safety(run: Run, plan: Sequence[PlannedRun], bench: BenchConfig | None = None) -> list[SafetyRun]:
    """Carry out the runs that are missing in the folder, one after the other; return all.

    bench: whose fakes are started, by default `wire`. Raises the errors of `Run.each`, and `DeviceError` if a
    program does not reach the moment of its event.
    """
    common = f"seed {run.seed}, {len(plan)} runs, "
    with ExitStack() as stack:
        place = cache(lambda: stack.enter_context(safety_place(run.results_folder, bench)))
        return run.each(
            lambda planned: campaign.retry(partial(place().run, planned), place().put_in_order),
            plan,
            lambda planned: common + str(planned),
            SafetyRun,
            workers=1,
            common=common,
            finish=lambda _, done: str(done),
        )


@contextmanager
def safety_place(folder: Path, bench: BenchConfig | None) -> "Iterator[_Place]":
    """Start a bench's fakes with a separate record of the hand's state, and finish a first lift there."""
    before = os.environ.get(STATE)
    os.environ[STATE] = str(folder / "state")
    try:
        with campaign.serve(WireBench, bench) as benches:
            place = _Place(folder, benches)
            campaign.retry(place.finish_a_lift, place.put_in_order)
            yield place
    finally:
        os.environ.pop(STATE)
        os.environ.update({} if before is None else {STATE: before})


class _Place:
    """A served bench, its file, and a session with one finished lift. benches: gives the addresses."""

    def __init__(self, folder: Path, benches: WireBench) -> None:
        self._config, self._call, self._grasp_m = benches.config, benches.call, benches.grasp_m
        self._real = folder / "real.toml"
        self._one, self._session = folder / "one", folder / "session"
        real = campaign.as_real(self._config)
        fed = real.require("table").model_copy(update={"feeder": FEEDER})
        write_bench(self._real, real.model_copy(update={"table": fed}))

    def finish_a_lift(self) -> None:
        shutil.rmtree(self._one, ignore_errors=True)
        with self._trial(self._one) as program:
            while not accepted_lifts(read_lifts(self._one)):
                if program.poll() is not None:
                    raise DeviceError(
                        f"safety: the trial ended too early: {campaign.wait_for_end(program, END_S)}"
                    )
                time.sleep(0.1)
            program.send_signal(signal.SIGINT)
            campaign.wait_for_end(program, END_S)
        if reason := self.put_in_order():
            raise DeviceError(f"safety: the bench cannot be put in order: {reason}")

    def run(self, planned: PlannedRun) -> SafetyRun:
        """Start the second lift, cause the event, and assess the motions after it.

        After SIGSTOP the motions before the program is continued are assessed.
        """
        shutil.rmtree(self._session, ignore_errors=True)
        shutil.copytree(self._one, self._session)
        event, call = planned.event, self._call
        with self._trial(self._session) as program:
            moment = planned.stage, planned.after_s, self._grasp_m
            stage = campaign.wait_for(*moment, call, lambda: program.poll() is not None)
            if stage is None:
                raise DeviceError(
                    f"safety: {planned} ended too early: {campaign.wait_for_end(program, END_S)}"
                )
            event_ns = campaign.strike(event, call, program)
            stopped = signal.SIGSTOP in event.signals
            said = "" if stopped else campaign.wait_for_end(program, END_S)
            campaign.let_pass(call, STOPPED_S if stopped else SETTLE_S)
            track = campaign.read_track(call, event_ns)
            if stopped:
                program.send_signal(signal.SIGCONT)
                said = campaign.wait_for_end(program, END_S)
        stop, kept, found = campaign.standstill(track, event_ns), self._is_kept(), self._fault()
        return SafetyRun(
            number=planned.number,
            event=event.name,
            stage=stage,
            still_s=round(stop.after_s, 4),
            way_mm=round(1e3 * stop.way_m, 2),
            dropped=campaign.was_dropped(track, self._grasp_m),
            unasked=campaign.find_unasked_motion(event, stage, track, event_ns, self._grasp_m),
            kept=kept,
            ended=program.returncode,
            said=said,
            fault=found,
            not_continued=self.put_in_order() or self._continue(),
        )

    @contextmanager
    def _trial(self, session: Path) -> "Iterator[subprocess.Popen[str]]":
        self._call("place", object=OBJECT, seed=1)
        with campaign.start_trial(self._real, session, OBJECT) as program:
            try:
                yield program
            finally:
                program.kill()

    def _is_kept(self, lift: int = 1) -> bool:
        try:
            usable = read_usable_lifts(self._session, checked=True)
        except RigError:
            return False
        return any(row.lift == lift for row in usable.lifts)

    def _fault(self) -> str:
        try:
            return next((row.fault for row in read_lifts(self._session) if row.fault), "")
        except RigError:
            return ""

    def _continue(self) -> str:
        """Continue the session, which finishes its second lift. Return the reason for a failure."""

        def finish() -> None:
            with self._trial(self._session) as program:
                said = campaign.wait_for_end(program, END_S)
            if program.returncode or not self._is_kept(lift=2):
                raise DeviceError(said or "the lift is not whole on disk")

        try:
            campaign.retry(finish, self.put_in_order)
        except DeviceError as error:
            return str(error)
        return ""

    def put_in_order(self) -> str:
        """Put the bench in order, answering all questions with yes. Return the reason for a failure."""
        self._call("fault", device="all", kind="clear")
        campaign.switch_on(getattr(self._config.arm, "host", ""))
        benches = WireBench(self._config)
        try:
            with closing(benches), benches.for_lift(1, "in order") as (bench, operator):
                make_ready(bench, operator, after_fault=True)
        except (DeviceError, InputError) as error:
            return f"{type(error).__name__}: {error}"
        return ""


@dataclass(frozen=True, slots=True)
class SafetyOptions:
    full: bool = option(False, f"Each event once in every stage: {len(EVENTS) * len(Stage)} runs, 3 hours.")
    events: list[str] | None = option(
        None, "Only events whose name contains this; repeat for more.", "--event"
    )
    bench: str = option("wire", "wire, or the path of a bench file whose \\[fakes] are started for it.")


def measure(options: SafetyOptions, run: Run) -> Report:
    """Stop, kill or break a lift at random moments; print how the arm comes to rest.

    The trial is a separate program on a simulated bench that counts as real. Its events are signals to the
    program, such as Ctrl-C, SIGHUP and kill -9, a full disk, and faults of the arm, the gripper, a fingertip
    and the camera: each once in the plain run, about 50 s each. After each the bench is put in order, and the
    trial continues. Exit code 4 if an object was dropped, if anything moved unasked, if a finished lift was
    lost, if the arm did not stand within 20 mm in the approach, if a fault in mid-lift was not noticed or not
    named, or if the next lift did not run. Times are printed and not judged, because they depend on the load
    of the computer.

    Examples:
      rig benchmark safety
      rig benchmark safety --event arm --event "gripper silent" --json
      rig benchmark safety --bench slow.toml
      rig benchmark safety --full --out safety --resume --readme docs/measurements.md
    """
    bench = load_bench(options.bench)
    if bench.fakes is None or bench.fakes.control is not None:
        raise InputError(
            f"bench '{bench.name}': faults are injected into fakes that the benchmark starts itself; give a "
            "bench of real drivers with an empty [fakes] table, as wire"
        )
    wanted = [text.lower() for text in options.events or [""]]
    events = [event for event in EVENTS if any(text in event.name.lower() for text in wanted)]
    if not events:
        names = ", ".join(event.name for event in EVENTS)
        raise InputError(f"no event contains {' or '.join(wanted)}; events are: {names}")
    runs = run_safety(run, plan_runs(run.seed, options.full, events), bench)
    table, limits = safety_table(bench.name, runs), judge_runs(runs)
    what = "longest time (s) and way (mm) from the event to standstill"
    head = f"SIMULATED, {len(runs)} runs, seed {run.seed}: {what}, by stage of the lift."
    lines = [f"- {of.name}: {of.shown}{f' ({of.asked})' if of.asked else ''}" for of in limits]
    section = "\n".join([head, "", table.markdown(), "", *lines])
    return Report((table,), limits, "the rig", section=section)


def judge_runs(runs: Sequence[SafetyRun]) -> tuple[Measured, ...]:
    """Return all limits; those on a stage or event of which there is no run are left out."""
    stopped = [run for run in runs if BY_NAME[run.event].after in (After.STAYS, After.SAFE_END)]
    lost = [run for run in runs if BY_NAME[run.event].after is After.NOTICED and BY_NAME[run.event].faults]
    way_mm = [run.way_mm for run in stopped if run.stage is Stage.APPROACH]
    lost_s = [run.still_s for run in lost if run.stage is Stage.LIFT]
    still_s = [run.still_s for run in stopped]
    return (
        at_most("objects dropped", sum(run.dropped for run in runs), 0),
        at_most("runs in which something moved unasked", sum(bool(run.unasked) for run in runs), 0),
        at_most("finished lifts lost", sum(not run.kept for run in runs), 0),
        *(informative("from the event to standstill, s", max(still_s)) for _ in still_s[:1]),
        *(at_most("way to standstill in the approach, mm", max(way_mm), APPROACH_MM) for _ in way_mm[:1]),
        *(informative("from a fault in mid-lift to standstill, s", max(lost_s)) for _ in lost_s[:1]),
        at_most("programs that ended without a reason", sum(not run.ended_well for run in runs), 0),
        at_most("faults in mid-lift not noticed or not named", sum(not run.noticed for run in runs), 0),
        at_most("next lifts that did not run", sum(bool(run.not_continued) for run in runs), 0),
    )


def safety_table(bench: str, runs: Sequence[SafetyRun]) -> Table:
    title = f"SIMULATED bench '{bench}': longest time and way from the event to standstill"
    columns = ("event", "runs", *(f"{stage}: s, mm" for stage in Stage), "dropped", "unasked", "lift lost")
    rows = []
    for name in BY_NAME:
        if not (of := [run for run in runs if run.event == name]):
            continue
        stages = [[run for run in of if run.stage is stage] for stage in Stage]
        longest = [
            f"{max(r.still_s for r in s):.2f}, {max(r.way_mm for r in s):.1f}" if s else NONE for s in stages
        ]
        wrong = [sum(r.dropped for r in of), sum(bool(r.unasked) for r in of), sum(not r.kept for r in of)]
        continued = f"{sum(not r.not_continued for r in of)} of {len(of)}"
        rows.append((name, str(len(of)), *longest, *map(str, wrong), continued))
    return Table(title, (*columns, "next lift"), rows, records=tuple(runs))


STUDY = Study(
    "safety", SafetyOptions, measure, "runs", ("out", "resume", "readme", "seed"), keeps_results=True
)
