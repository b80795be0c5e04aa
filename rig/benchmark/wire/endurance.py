"""`rig benchmark endurance`: hold an object still for an hour, in real time, over the wire protocols.

A long session must not drop frames, must report angles in time, must report the same angle for the same
contact, and its memory, threads and open files must not grow. Everything is recorded as in a lift, one file
per minute.
"""

import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, Clock
from drivers.types import ArmState, Frame, GripperState, Pose
from protocols.observer import LiftObserver, Phase
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.slip_trial import REFERENCE_S, SETTLE_S
from protocols.steps import approach, close_to_contact, open_and_rise, start_watching, tighten
from rig.benchmark.harness import Report, Run, Study
from rig.benchmark.measured import Measured, at_least, at_most, informative
from rig.benchmark.wire.campaign import WireBench, served
from rig.config import BenchConfig, load_bench
from rig.declared import option
from rig.experiments.lift_plan import LiftTask, TrialSettings, new_measurement, plan_lift
from rig.lift.measurement import LiftMeasurement
from rig.sessions.recorder import LiftRecorder
from rig.sessions.unfinished import BackgroundFile
from rig.tactile.estimators import choose_estimator

CHILDREN = b"drivers."  # part of the command line of every process that a driver starts


@dataclass(frozen=True, slots=True)
class Minute:
    """Measurements of one minute.

    frames, dropped: counts over both fingertips and the camera. p50_ms, p99_ms: percentiles of the time from
    capture to angle, of the slower fingertip. memory_mb, threads, files: of this program and of the drivers'
    processes, at the end of the minute.
    """

    frames: int
    dropped: int
    jumped: int  # tactile frames whose times jumped, which are not estimated
    p50_ms: float
    p99_ms: float
    wander_deg: float  # largest difference of an angle from the mean of the first minute
    answered: float  # share of tactile frames with an angle
    recorded_mb: float  # size of the minute's recording
    memory_mb: float
    threads: int
    files: int

    def __str__(self) -> str:
        return (
            f"{self.frames} frames, {self.dropped} dropped; angle after {self.p50_ms:.1f} ms, 99 % "
            f"{self.p99_ms:.1f} ms; at most {self.wander_deg:.2f} deg off; "
            f"{self.recorded_mb:.0f} MB recorded; {self.memory_mb:.0f} MB, "
            f"{self.threads} threads, {self.files} files"
        )


class MinuteRecordings:
    """Records into one file per minute below a folder, and deletes each file once it is complete.

    A completed file is flushed to the disk by a background thread, so that the control loop does not wait.
    """

    def __init__(self, folder: Path) -> None:
        self._files = (BackgroundFile([folder / f"{number:06d}.mcap"]) for number in count(1))
        self._closer = ThreadPoolExecutor(1)
        self._closing: Future[None] | None = None
        self._file = next(self._files)
        self.recorder = LiftRecorder(self._file)

    def next_file(self) -> int:
        """Begin the next file; return the size of the last one, bytes. Raises `RecordingError`."""

        def flush_and_delete(file: BackgroundFile) -> None:
            file.close()
            file.path.unlink()

        if self._closing is not None:
            self._closing.result()
        self.recorder.close()
        size = self._file.tell()
        self._closing = self._closer.submit(flush_and_delete, self._file)
        self._file = next(self._files)
        self.recorder = LiftRecorder(self._file)
        return size

    def close(self) -> None:
        try:
            self.next_file()
        finally:
            self._closer.shutdown()


class StillContact(LiftObserver):
    """Records and measures a lift until phase B, and keeps the angles of the current minute only."""

    def __init__(self, measurement: LiftMeasurement, clock: Clock, recordings: MinuteRecordings) -> None:
        self._measurement, self._tips = measurement, measurement.angle.tips
        self._clock, self._recordings = clock, recordings
        self.late_ns: dict[str, list[int]] = {serial: [] for serial in self._tips}
        self._zero_deg: dict[str, float] = {}
        self._counted = (0, 0, 0)

    def phase(self, phase: Phase, time_ns: int) -> None:
        self._recordings.recorder.phase(phase, time_ns)
        self._measurement.phase(phase, time_ns)

    def frame(self, frame: Frame) -> None:
        self._recordings.recorder.frame(frame)
        self._measurement.frame(frame)
        if frame.serial in self._tips and self._tips[frame.serial].samples:
            self.late_ns[frame.serial].append(self._clock.now_ns() - frame.time_ns)

    def arm(self, state: ArmState) -> None:
        self._recordings.recorder.arm(state)  # not for the measurement, which would search for markers

    def gripper(self, state: GripperState) -> None:
        self._recordings.recorder.gripper(state)

    def touching(self, serial: str) -> bool:
        return self._measurement.touching(serial)

    def begin_minute(self) -> int:
        """Begin a minute and a recording, without earlier angles; return the size of the last one, bytes."""
        for serial, tip in self._tips.items():
            tip.samples.clear()
            self.late_ns[serial].clear()
        self._counted = self._counts()
        return self._recordings.next_file()

    def minute(self) -> Minute:
        resources = _resources()
        frames, dropped, jumped = np.subtract(self._counts(), self._counted).tolist()
        late_ms = [np.percentile(late, (50, 99)) * 1e3 / NS_PER_S for late in self.late_ns.values()]
        p50_ms, p99_ms = (float(max(values)) for values in zip(*late_ms, strict=True))
        off_deg = np.concatenate([self._off_deg(serial) for serial in self._tips])
        known, recorded_mb = np.isfinite(off_deg), self.begin_minute() / 1e6
        wander_deg, answered = float(np.nanmax(off_deg)) if known.any() else float("nan"), float(known.mean())
        return Minute(frames, dropped, jumped, p50_ms, p99_ms, wander_deg, answered, recorded_mb, **resources)

    def _counts(self) -> tuple[int, int, int]:
        tallies = self._measurement.tallies
        jumped = sum(tallies[serial].jumped for serial in self._tips)
        return sum(of.frames for of in tallies.values()), sum(of.dropped for of in tallies.values()), jumped

    def _off_deg(self, serial: str) -> NDArray[np.float64]:
        """Return the distances of this minute's angles from the mean of the first minute with an angle."""
        angles = np.array([sample.angle_deg for sample in self._tips[serial].samples], float)
        if serial not in self._zero_deg and np.isfinite(angles).any():
            self._zero_deg[serial] = float(np.nanmean(angles))
        return np.abs(angles - self._zero_deg.get(serial, np.nan))


def _resources() -> dict[str, Any]:
    """Return memory, threads and open files of this program and of its drivers' processes."""
    processes = [Path("/proc/self")]
    for children in Path("/proc/self/task").glob("*/children"):
        all_children = [Path("/proc") / pid for pid in children.read_text().split()]
        processes += [child for child in all_children if CHILDREN in (child / "cmdline").read_bytes()]
    page_mb = os.sysconf("SC_PAGE_SIZE") / 2**20
    return {
        "memory_mb": sum(int((p / "statm").read_text().split()[1]) for p in processes) * page_mb,
        "threads": sum(len(list((p / "task").iterdir())) for p in processes),
        "files": sum(len(list((p / "fd").iterdir())) for p in processes),
    }


OBJECT = "t1"
MINUTE_S = 60.0
WANDER_DEG, GROWN_MB, ANSWERED = 0.3, 10.0, 0.95


@dataclass(frozen=True, slots=True)
class EnduranceOptions:
    hours: float = option(1.0, "Duration, in real time.", min=0.01, max=100)


def measure(options: EnduranceOptions, run: Run) -> Report:
    """Hold an object still over the wire protocols, in real time, and print the measurements per minute.

    All frames are recorded as in a lift, into a file per minute of about 0.3 GB in the folder for temporary
    files (TMPDIR), which is then deleted. Exit code 4 if a frame was dropped or its time jumped, if the angle
    changed by more than 0.3 degrees, or if memory, threads or open files grew. Times are printed and not
    judged, because they depend on the load of the computer.

    Examples:
      rig benchmark endurance
      rig benchmark endurance --hours 0.05 --json
    """
    bench, total = load_bench("wire"), max(1, round(60.0 * options.hours))
    minutes = measure_endurance(total, lambda number, of: run.progress(number, total, str(of)), bench)
    limits = judge_endurance(minutes)
    return Report((), limits, "the contact at rest", figures={"minutes": [asdict(of) for of in minutes]})


def judge_endurance(minutes: Sequence[Minute]) -> tuple[Measured, ...]:
    first, last = minutes[0], minutes[-1]
    wander_deg = [minute.wander_deg for minute in minutes]
    farthest_deg = max(wander_deg) if np.isfinite(wander_deg).all() else None
    return (
        at_most("frames dropped", sum(minute.dropped for minute in minutes), 0),
        at_most("frames whose time jumped", sum(minute.jumped for minute in minutes), 0),
        informative("capture to angle, 99th percentile, ms", max(of.p99_ms for of in minutes)),
        at_most("farthest angle from the first minute, deg", farthest_deg, WANDER_DEG),
        at_least("share of frames answered, worst minute", min(m.answered for m in minutes), ANSWERED),
        at_most("growth of memory since the first minute, MB", last.memory_mb - first.memory_mb, GROWN_MB),
        at_most("threads more than in the first minute", last.threads - first.threads, 0),
        at_most("open files more than in the first minute", last.files - first.files, 0),
    )


def measure_endurance(
    minutes: int, progress: Callable[[int, Minute], None], wanted: BenchConfig, minute_s: float = MINUTE_S
) -> list[Minute]:
    """Grasp an object that stands on its support, as a lift does, and return the measurements of each minute.

    progress: called after each minute with its number, from 1, and its measurements. wanted: the bench whose
    fakes are reached over the wire protocols. minute_s: length of a "minute" in s; shorter in tests. Raises
    the device's error if a device fails, `RecordingError` if a recording cannot be written.
    """
    measured = []
    with (
        tempfile.TemporaryDirectory(prefix="endurance-") as folder,
        closing(MinuteRecordings(Path(folder))) as recordings,
        served(WireBench, wanted) as benches,
        benches.for_lift(0, "endurance") as (bench, operator),
    ):
        make_ready(bench, operator)
        settings = TrialSettings(benches.config, 0, choose_estimator())
        plan = plan_lift(settings, LiftTask(1, OBJECT, 1), Pose(benches.config.require("table").position_m))
        operator.place(plan.object_id, plan.object_name)
        observer = StillContact(new_measurement(settings), bench.clock, recordings)
        with safe_end(bench):
            approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
            pump = start_watching(bench, observer, REFERENCE_S)
            tighten(bench, pump, observer, close_to_contact(bench, pump, observer), plan.grip_steps)
            pump.run_for(SETTLE_S)
            observer.begin_minute()  # a contact that has just been closed still turns a little
            for number in range(1, minutes + 1):
                pump.run_for(minute_s)
                measured.append(observer.minute())
                progress(number, measured[-1])
            open_and_rise(bench, plan.base_T_grasp, plan.width_m, pump)
    return measured


STUDY = Study("endurance", EnduranceOptions, measure, "minutes", shared=())
