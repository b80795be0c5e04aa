"""`rig benchmark endurance`: hold an object still for an hour, in real time, over the wire protocols.

A long session must not drop frames, must report angles in time, must report the same angle for the same
contact, and its memory, threads and open files must not grow. Everything is recorded as in a lift, one file
per minute.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.bench import Bench
from drivers.clock import NS_PER_S, Clock
from drivers.tally import FrameTally
from drivers.types import ArmState, Frame, GripperState, Image, Pose
from protocols.observer import LiftObserver, Phase
from protocols.pump import Pump
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.slip_trial import REFERENCE_S, SETTLE_S, LiftPlan
from protocols.steps import approach, close_to_contact, open_and_rise, start_watching, tighten
from rig.bench.fakes_process import started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.measured import Measured, at_least, at_most
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import LiftTask, TrialSettings, plan_lift
from rig.sessions.background_file import BackgroundFile
from rig.sessions.recorder import LiftRecorder
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.touch import TouchDebounce
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State, TactileEstimator

OBJECT = "t1"
MINUTE_S = 60.0
WANDER_DEG, GROWN_MB, ANSWERED = 0.3, 10.0, 0.95
CHILDREN = b"drivers."
"""Part of the command line of every process that a driver starts."""


@dataclass(frozen=True, slots=True)
class Minute:
    """Measurements of one minute.

    Attributes:
        frames, dropped: counts over both fingertips and the camera.
        jumped: tactile frames at which an estimator detected a jump of the frame times.
        p50_ms, p99_ms: percentiles of the time from capture to angle, of the slower fingertip.
        wander_deg: largest difference of an angle from the mean of the first minute.
        answered: share of tactile frames with an angle.
        recorded_mb: size of the minute's recording.
        memory_mb, threads, files: of this program and of the drivers' processes, at the end of the minute.

    """

    frames: int
    dropped: int
    jumped: int
    p50_ms: float
    p99_ms: float
    wander_deg: float
    answered: float
    recorded_mb: float
    memory_mb: float
    threads: int
    files: int


@dataclass(slots=True)
class _Tip:
    """A fingertip: its frames before the contact, then its estimator and the angles of this minute."""

    sign: int
    aspect: float | None
    reference: list[Image] = field(default_factory=list)
    estimator: TactileEstimator | None = None
    touch: TouchDebounce = field(default_factory=TouchDebounce)
    angles_deg: list[float] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)
    jumped: int = 0
    zero_deg: float | None = None


class MinuteRecordings:
    """Records into one file per minute below a folder, and deletes each file once it is complete.

    A completed file is flushed to the disk by a background thread, so that the control loop does not wait.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._number = folder, 0
        self._closer = ThreadPoolExecutor(1)
        self._closing: Future[None] | None = None
        self._open()

    def _open(self) -> None:
        self._number += 1
        self._file = BackgroundFile([self._folder / f"{self._number:06d}.mcap"])
        self.recorder = LiftRecorder(self._file)

    def next_file(self) -> int:
        """Complete the current file, begin the next, and return the size of the completed one in bytes.

        Raises `RecordingError` if this or an earlier file could not be written.
        """
        if self._closing is not None:
            self._closing.result()
        self.recorder.close()
        size = self._file.tell()
        self._closing = self._closer.submit(_flush_and_delete, self._file)
        self._open()
        return size

    def close(self) -> None:
        """Complete and delete the last file."""
        try:
            self.next_file()
        finally:
            self._closer.shutdown()


def _flush_and_delete(file: BackgroundFile) -> None:
    file.close()
    file.path.unlink()


class StillContact(LiftObserver):
    """Estimates and records both fingertips as in a lift, and keeps the angles of the current minute only."""

    def __init__(self, bench: BenchConfig, clock: Clock, recordings: MinuteRecordings) -> None:
        aspects = bench.pixel_aspects()
        self._tips = {t.serial: _Tip(t.sign, aspects.get(t.serial)) for t in bench.tactile}
        self._tallies = {serial: FrameTally() for serial in (*self._tips, bench.camera.serial)}
        self._clock, self._choice = clock, choose_estimator()
        self._recordings = recordings
        self._counted = (0, 0)

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Record the phase; create the estimators when the grasp begins."""
        self._recordings.recorder.phase(phase, time_ns)
        if phase is Phase.GRASP:
            for tip in self._tips.values():
                tip.estimator = self._choice.make(mean_background(tip.reference), tip.aspect, tip.sign)
                tip.reference = []

    def frame(self, frame: Frame) -> None:
        """Record a frame and estimate its angle."""
        self._recordings.recorder.frame(frame)
        self._tallies[frame.serial].add(frame)
        tip = self._tips.get(frame.serial)
        if tip is None:
            return
        if tip.estimator is None:
            tip.reference.append(frame.image)
            return
        sample = tip.estimator.update(frame.image, frame.time_ns)
        tip.touch.update(sample.state is not State.NO_CONTACT)
        tip.angles_deg.append(np.nan if sample.angle_deg is None else sample.angle_deg)
        tip.late_ns.append(self._clock.now_ns() - frame.time_ns)
        tip.jumped += sample.jumped

    def arm(self, state: ArmState) -> None:
        """Record the arm's state."""
        self._recordings.recorder.arm(state)

    def gripper(self, state: GripperState) -> None:
        """Record the gripper's state."""
        self._recordings.recorder.gripper(state)

    def touching(self, serial: str) -> bool:
        """Return whether a fingertip has shown contact in its last frames."""
        return self._tips[serial].touch.sure

    def begin_minute(self) -> int:
        """Begin a minute and a recording; discard earlier angles. Return the recorded size in bytes.

        A contact that has just been closed still turns a little, so angles before the first minute are
        not used.
        """
        for tip in self._tips.values():
            tip.angles_deg, tip.late_ns, tip.jumped = [], [], 0
        self._counted = self._count()
        return self._recordings.next_file()

    def minute(self) -> Minute:
        """Return the measurements since `begin_minute`, and begin the next minute."""
        tips = list(self._tips.values())
        late_ms = [np.percentile(tip.late_ns, (50, 99)) * 1e3 / NS_PER_S for tip in tips]
        angles = [np.array(tip.angles_deg) for tip in tips]
        for tip, told in zip(tips, angles, strict=True):
            if tip.zero_deg is None and np.isfinite(told).any():
                tip.zero_deg = float(np.nanmean(told))
        both = zip(tips, angles, strict=True)
        off = [np.abs(told - tip.zero_deg) for tip, told in both if tip.zero_deg is not None]
        before, jumped, resources = self._counted, sum(tip.jumped for tip in tips), _resources()
        recorded = self.begin_minute()
        return Minute(
            self._counted[0] - before[0],
            self._counted[1] - before[1],
            jumped,
            *(float(max(values)) for values in zip(*late_ms, strict=True)),
            wander_deg=float(np.nanmax(np.concatenate(off))) if off else float("nan"),
            answered=float(np.isfinite(np.concatenate(angles)).mean()),
            recorded_mb=recorded / 1e6,
            **resources,
        )

    def _count(self) -> tuple[int, int]:
        """Return how many frames arrived and how many were dropped until now."""
        tallies = self._tallies.values()
        return sum(tally.frames for tally in tallies), sum(tally.dropped for tally in tallies)


def measure_endurance(
    minutes: int,
    progress: Callable[[int, Minute], None] = lambda number, minute: None,
    bench: BenchConfig | None = None,
    minute_s: float = MINUTE_S,
) -> list[Minute]:
    """Hold an object that stands on its support, and return the measurements of each minute.

    Args:
        minutes: how many.
        progress: called after each minute with its number, from 1, and its measurements.
        bench: a bench whose fakes are reached over the wire protocols, by default `wire`.
        minute_s: length of a "minute" in s; shorter in tests.

    Raises the device's error if a device fails, `RecordingError` if a recording cannot be written.

    """
    told = []
    with _grasping(bench or load_bench("wire")) as (pump, observer):
        observer.begin_minute()
        for number in range(1, minutes + 1):
            pump.run_for(minute_s)
            told.append(observer.minute())
            progress(number, told[-1])
    return told


@contextmanager
def _grasping(wanted: BenchConfig) -> Iterator[tuple[Pump, StillContact]]:
    """Grasp an object as a lift does, and release it at the end."""
    with (
        tempfile.TemporaryDirectory(prefix="endurance-") as folder,
        closing(MinuteRecordings(Path(folder))) as recordings,
        started_fakes(wanted) as config,
        closing(StandingBench(config, ConsoleOperator(lambda _: True), "")) as benches,
        benches.for_lift(0, "endurance") as (bench, operator),
    ):
        make_ready(bench, operator)
        settings = TrialSettings(config, 0, choose_estimator())
        plan = plan_lift(settings, LiftTask(1, OBJECT, 1), Pose(config.table.position_m))
        operator.place(plan.object_id, plan.object_name)
        observer = StillContact(config, bench.clock, recordings)
        with safe_end(bench):
            pump = _grasped(bench, plan, observer)
            yield pump, observer
            open_and_rise(bench, plan.base_T_grasp, plan.width_m, pump)


def _grasped(bench: Bench, plan: LiftPlan, observer: StillContact) -> Pump:
    approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
    pump = start_watching(bench, observer, REFERENCE_S)
    tighten(bench, pump, observer, close_to_contact(bench, pump, observer), plan.grip_counts)
    pump.run_for(SETTLE_S)
    return pump


def judge_endurance(minutes: list[Minute], period_ms: float) -> list[Measured]:
    """Compare with the limits. period_ms: time between two frames of a fingertip, the largest latency."""
    first, last = minutes[0], minutes[-1]
    late_ms = max(minute.p99_ms for minute in minutes)
    return [
        at_most("frames dropped", sum(minute.dropped for minute in minutes), 0),
        at_most("frames whose time jumped", sum(minute.jumped for minute in minutes), 0),
        at_most("capture to angle, 99th percentile, ms", late_ms, period_ms),
        at_most("farthest angle from the first minute, deg", _wander(minutes), WANDER_DEG),
        at_least("share of frames answered, worst minute", min(m.answered for m in minutes), ANSWERED),
        at_most("growth of memory since the first minute, MB", last.memory_mb - first.memory_mb, GROWN_MB),
        at_most("threads more than in the first minute", last.threads - first.threads, 0),
        at_most("open files more than in the first minute", last.files - first.files, 0),
    ]


def _wander(minutes: list[Minute]) -> float | None:
    values = [minute.wander_deg for minute in minutes]
    return float(np.max(values)) if np.isfinite(values).all() else None


def _resources() -> dict[str, float | int]:
    """Return memory, threads and open files of this program and of its drivers' processes."""
    processes = [Path(f"/proc/{os.getpid()}"), *_children()]
    page_mb = os.sysconf("SC_PAGE_SIZE") / 2**20
    return {
        "memory_mb": sum(int((p / "statm").read_text().split()[1]) for p in processes) * page_mb,
        "threads": sum(len(list((p / "task").iterdir())) for p in processes),
        "files": sum(len(list((p / "fd").iterdir())) for p in processes),
    }


def _children() -> Iterator[Path]:
    for children in Path("/proc/self/task").glob("*/children"):
        for pid in children.read_text().split():
            process = Path(f"/proc/{pid}")
            if CHILDREN in (process / "cmdline").read_bytes():
                yield process
