"""Records and measures an object that is held still, minute by minute."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, Clock
from drivers.tally import FrameTally
from drivers.types import ArmState, Frame, GripperState, Image
from protocols.observer import LiftObserver, Phase
from rig.config import BenchConfig
from rig.sessions.recorder import LiftRecorder
from rig.sessions.unfinished import BackgroundFile
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.touch import TouchDebounce
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State, TactileEstimator

CHILDREN = b"drivers."
"""Part of the command line of every process that a driver starts."""


@dataclass(frozen=True, slots=True)
class Minute:
    """Measurements of one minute.

    frames, dropped: counts over both fingertips and the camera. jumped: tactile frames at which an estimator
    detected a jump of the frame times. p50_ms, p99_ms: percentiles of the time from capture to angle, of the
    slower fingertip. wander_deg: largest difference of an angle from the mean of the first minute. answered:
    share of tactile frames with an angle. recorded_mb: size of the minute's recording. memory_mb, threads,
    files: of this program and of the drivers' processes, at the end of the minute.
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

    def off_deg(self) -> NDArray[np.float64]:
        """Return the distances of this minute's angles from the mean of the first minute with an angle."""
        angles = np.array(self.angles_deg, float)
        if self.zero_deg is None and np.isfinite(angles).any():
            self.zero_deg = float(np.nanmean(angles))
        return np.abs(angles - (np.nan if self.zero_deg is None else self.zero_deg))


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
        tallies = self._tallies.values()
        self._counted = sum(tally.frames for tally in tallies), sum(tally.dropped for tally in tallies)
        return self._recordings.next_file()

    def minute(self) -> Minute:
        """Return the measurements since `begin_minute`, and begin the next minute."""
        tips, before, resources = self._tips.values(), self._counted, _resources()
        late_ms = [np.percentile(tip.late_ns, (50, 99)) * 1e3 / NS_PER_S for tip in tips]
        off_deg = np.concatenate([tip.off_deg() for tip in tips])
        answered = np.isfinite([angle for tip in tips for angle in tip.angles_deg]).mean()
        jumped = sum(tip.jumped for tip in tips)
        recorded = self.begin_minute()
        return Minute(
            self._counted[0] - before[0],
            self._counted[1] - before[1],
            jumped,
            *(float(max(values)) for values in zip(*late_ms, strict=True)),
            wander_deg=float(np.nanmax(off_deg)) if np.isfinite(off_deg).any() else float("nan"),
            answered=float(answered),
            recorded_mb=recorded / 1e6,
            **resources,
        )


def _resources() -> dict[str, float | int]:
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
