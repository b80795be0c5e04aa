"""Observers of a lift: its recording, several in order, delays of frames; the recorded true angle."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, Clock, SystemClock, to_ns
from drivers.errors import DeviceError
from drivers.images import encode_jpeg
from drivers.types import ArmState, Frame, GripperState
from protocols.observer import NO_EVENTS, LiftEvents, LiftObserver, Phase, ReactionStep
from rig.lift.measurement import LiftMeasurement
from rig.sessions.about import RecordingAbout
from rig.sessions.reading import recorded_angles
from rig.sessions.recorder import LiftRecorder
from rig.sessions.records import LatencyTimes
from rig.sessions.unfinished import BackgroundFile, complete_at_end, new_recording
from rig.tactile.angles import MARKERS, Angles
from rig.tactile.contact.finder import ContactFinder

OUTLINE_EVERY_S = 0.1
"""Interval between recorded outlines."""
SEEN_WITHIN_S = 0.2
"""Age of the markers' place up to which only their surroundings are stored: six frames at 30 per second."""
GREY, MARKER_QUALITY = 128, 90
"""Grey level of the other pixels; JPEG quality of the picture. True angles of three SIMULATED lifts, measured
again from these pictures, differ by at most 0.010 degrees, at a sigma of 0.007."""
OUTLINE_STEP = 4
"""The points of an outline are 1 px apart; every 4th point is kept."""


class OutlineObserver(LiftEvents):
    """Records the outline of each contact every `OUTLINE_EVERY_S`, for viewers; no angle depends on it.

    It must come after the measurement, because it needs its backgrounds.
    """

    def __init__(self, measurement: LiftMeasurement, recorder: LiftRecorder) -> None:
        self._measurement = measurement
        self._recorder = recorder
        self._finders: dict[str, ContactFinder] = {}
        self._latest_ns: dict[str, int] = {}

    def frame(self, frame: Frame) -> None:
        background = self._measurement.backgrounds.get(frame.serial)
        if background is None or Phase.LOWER in self._measurement.phases:
            return
        watch = self._measurement.watch
        if (watch and watch.slip_ns() is not None) or self._measurement.tallies[frame.serial].out_of_time:
            return  # nothing must delay an arm that has to stop
        latest_ns = self._latest_ns.get(frame.serial)
        if latest_ns is not None and frame.time_ns - latest_ns < to_ns(OUTLINE_EVERY_S):
            return
        if frame.serial not in self._finders:
            self._finders[frame.serial] = ContactFinder(background)
        self._latest_ns[frame.serial] = frame.time_ns
        line = self._finders[frame.serial].find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]
        self._recorder.contact(frame.serial, [line] if len(line) else [], frame.time_ns)


class MarkerPictures:
    """Reduces the external camera's pictures to the surroundings of the markers, to store less.

    The markers are searched after a frame is stored, so the place is that in the frame before, with a margin.
    """

    def __init__(self, measurement: LiftMeasurement) -> None:
        self._serial, self._truth = measurement.bench.require("camera").serial, measurement.truth

    def jpeg(self, frame: Frame) -> bytes | None:
        """Return the JPEG to store; as received without markers shortly before, and of other sources."""
        if frame.serial != self._serial:
            return frame.jpeg
        corners = self._truth.newest_corners(frame.time_ns - to_ns(SEEN_WITHIN_S))
        if corners is None:
            return frame.jpeg
        places = corners.reshape(-1, 2)
        margin = np.ptp(corners, axis=1).max()  # the longest side of a marker's box
        left, top = np.maximum(places.min(axis=0) - margin, 0.0).astype(int)
        right, bottom = np.ceil(places.max(axis=0) + margin).astype(int)
        stored = np.full_like(frame.image, GREY)
        stored[top:bottom, left:right] = frame.image[top:bottom, left:right]
        return encode_jpeg(stored, MARKER_QUALITY)


@dataclass(frozen=True, slots=True)
class LiftRecording:
    """A recording in progress; by default one that records nothing.

    received: observer that stores the messages as received. outlines: stores outlines; it must come after the
    measurement. store: writes angles. files: by name in the session.
    """

    received: LiftEvents = NO_EVENTS
    outlines: LiftEvents = NO_EVENTS
    store: Callable[[Angles], None] = lambda angles: None
    files: Mapping[str, BackgroundFile] = field(default_factory=dict)


@contextmanager
def record_lift(
    folder: Path | None, name: str, about: RecordingAbout, measurement: LiftMeasurement, markers_only: bool
) -> Iterator[LiftRecording]:
    """Record a lift under an unfinished name, and complete the recording when the lift ends.

    folder: of the session; None for no recording. name: of the recording in it. markers_only: store only the
    surroundings of the markers of the camera's pictures. Raises `RecordingError` if it cannot be written.
    """
    if folder is None:
        yield LiftRecording()
        return
    file = new_recording(folder, name)
    stored = {"jpeg": MarkerPictures(measurement).jpeg} if markers_only else {}
    recorder = LiftRecorder(file, about, **stored)
    with complete_at_end(recorder, file):
        yield LiftRecording(recorder, OutlineObserver(measurement, recorder), recorder.angles, {name: file})


class LiftObservers(LiftObserver):
    """Forwards each event to several observers, in order. contact: the one that detects contacts."""

    def __init__(self, contact: LiftObserver, *observers: LiftEvents) -> None:
        self._contact, self._observers = contact, observers

    def phase(self, phase: Phase, time_ns: int) -> None:
        for observer in self._observers:
            observer.phase(phase, time_ns)

    def frame(self, frame: Frame) -> None:
        for observer in self._observers:
            observer.frame(frame)

    def arm(self, state: ArmState) -> None:
        for observer in self._observers:
            observer.arm(state)

    def gripper(self, state: GripperState) -> None:
        for observer in self._observers:
            observer.gripper(state)

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        for observer in self._observers:
            observer.reaction(step, time_ns, position)

    def touching(self, serial: str) -> bool:
        return self._contact.touching(serial)


def recorded_truth(recording: Path) -> Angles:
    """Read the markers' angle of a recorded lift. Raises `SessionError`."""
    return recorded_angles(recording, MARKERS)[MARKERS]


MOST_OFF_RATE = 0.05
"""Largest relative difference without a warning. Clocks of cameras are off by 1e-4; a delay that varies by
0.05 s over the 5 s of a lift is 0.01."""
LEAST_FRAMES, LEAST_SPAN_S = 30, 2.0
"""Fewest frames, and shortest time, from which a rate is computed."""


class _StoppedClock(Clock):
    def now_ns(self) -> int:
        return 0


NO_CLOCK = _StoppedClock()
"""The clock as long as no bench is connected; it stands at 0."""


class FrameDelays(LiftEvents):
    """Measures the delay of each frame by the bench's clock. It must be the last observer.

    Then a delay lasts from the capture of a frame until it has been recorded and estimated.
    """

    def __init__(self, clock: Clock = NO_CLOCK) -> None:
        self._clock = clock
        self._began_ns = clock.now_ns()
        self._phase = Phase.REFERENCE
        self._times_ns: dict[str, list[tuple[int, int]]] = {}
        self._late_ns: dict[str, list[int]] = {}

    def phase(self, phase: Phase, time_ns: int) -> None:
        self._phase = phase

    def frame(self, frame: Frame) -> None:
        now_ns = self._clock.now_ns()
        self._times_ns.setdefault(frame.serial, []).append((frame.time_ns, now_ns))
        if self._phase in (Phase.LIFT, Phase.HOLD):
            self._late_ns.setdefault(frame.serial, []).append(now_ns - frame.time_ns)

    def spent_s(self) -> float:
        """Return the time since this observer was created, s."""
        return round((self._clock.now_ns() - self._began_ns) / NS_PER_S, 6)

    def latency(self) -> dict[str, LatencyTimes]:
        """Return the delays in phases B and C, by serial, ms: median, 95th, 99th percentile, maximum.

        Empty with a simulated clock, which does not advance while angles are computed.
        """
        late_ns = self._late_ns if isinstance(self._clock, SystemClock) else {}
        return {
            serial: LatencyTimes(*(np.percentile(late, (50, 95, 99, 100)) * 1e3 / NS_PER_S).tolist())
            for serial, late in late_ns.items()
        }

    def clock_rates(self) -> dict[str, float]:
        """Return the speed of the stamps divided by that of the clock, by serial, where it is not about 1.

        A loaded computer delivers the frames of all sources later and later: what they have in common is not
        due to their clocks.
        """
        growth = {serial: g for serial, times in self._times_ns.items() if (g := _growth(times)) is not None}
        common = max(0.0, min(growth.values(), default=0.0)) if len(growth) > 1 else 0.0
        rates = {serial: 1.0 - (g - common) for serial, g in growth.items()}
        return {serial: round(rate, 3) for serial, rate in rates.items() if abs(rate - 1.0) > MOST_OFF_RATE}

    def check_clocks(self) -> None:
        """Raise `DeviceError` if stamps run at another speed: angle and markers cannot be compared then."""
        if rates := self.clock_rates():
            named = ", ".join(f"{name} at {rate:.2f}" for name, rate in rates.items())
            raise DeviceError(
                f"frames: time stamps at another speed than this computer's clock: {named}. If every lift "
                "has this fault, the capture time in rig doctor must be 'kernel'; otherwise the computer is "
                "overloaded: end other programs on it, or set a lower rate_hz in the bench file"
            )


def _growth(times_ns: Sequence[tuple[int, int]]) -> float | None:
    """Return by how much the delay of the frames grows per time; None for too few frames."""
    stamps, received = np.array(times_ns, np.int64).reshape(-1, 2).T
    third = len(times_ns) // 3
    first, last = np.s_[:third], np.s_[-third:]
    if len(times_ns) < LEAST_FRAMES or np.ptp(received) < to_ns(LEAST_SPAN_S):
        return None
    late = received - stamps
    return float(
        (np.median(late[last]) - np.median(late[first]))
        / (np.median(received[last]) - np.median(received[first]))
    )
