"""Record outlines and angles in addition to the events of a lift, and combine several observers.

Also read the true angle of a recorded lift, and measure the latency of frames.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.types import ArmState, Frame, GripperState
from protocols.observer import LiftEvents, LiftObserver, Phase, ReactionStep
from rig.lift.fusion import FusedSample
from rig.lift.marker_truth import TruthSeries
from rig.lift.measurement import LiftMeasurement
from rig.sessions.reading import recorded_angles
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC, LiftRecorder, RecordedAngle, slip_topic
from rig.sessions.timing import LatencyTimes
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.sample import SlipSample, State

OUTLINE_EVERY_S = 0.1
"""Interval between recorded outlines."""
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
        """Record the outline in a fingertip's frame if one is due."""
        background = self._measurement.backgrounds.get(frame.serial)
        if background is None or Phase.LOWER in self._measurement.phases:
            return
        if self._measurement.slip_ns() is not None or self._measurement.tallies[frame.serial].out_of_time:
            return  # nothing must delay an arm that has to stop
        latest_ns = self._latest_ns.get(frame.serial)
        if latest_ns is not None and frame.time_ns - latest_ns < to_ns(OUTLINE_EVERY_S):
            return
        if frame.serial not in self._finders:
            self._finders[frame.serial] = ContactFinder(background)
        self._latest_ns[frame.serial] = frame.time_ns
        line = self._finders[frame.serial].find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]
        self._recorder.contact(frame.serial, [line] if len(line) else [], frame.time_ns)


class LiftObservers(LiftObserver):
    """Forwards each event to several observers, in order. contact: the one that detects contacts."""

    def __init__(self, contact: LiftObserver, observers: Sequence[LiftEvents]) -> None:
        self._contact = contact
        self._observers = observers

    def followed_by(self, observer: LiftEvents) -> "LiftObservers":
        """Return the same observers with another one appended."""
        return LiftObservers(self._contact, (*self._observers, observer))

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Forward the start of a phase."""
        for observer in self._observers:
            observer.phase(phase, time_ns)

    def frame(self, frame: Frame) -> None:
        """Forward a frame."""
        for observer in self._observers:
            observer.frame(frame)

    def arm(self, state: ArmState) -> None:
        """Forward the arm's state."""
        for observer in self._observers:
            observer.arm(state)

    def gripper(self, state: GripperState) -> None:
        """Forward the gripper's state."""
        for observer in self._observers:
            observer.gripper(state)

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        """Forward a step of a reaction."""
        for observer in self._observers:
            observer.reaction(step, time_ns, position)

    def touching(self, serial: str) -> bool:
        """Whether a fingertip is in contact."""
        return self._contact.touching(serial)


def lift_angles(measurement: LiftMeasurement, truth: TruthSeries) -> Iterator[tuple[str, RecordedAngle]]:
    """Yield the angles of a lift in the form of a recording, each with its topic."""
    for serial, tip in measurement.angle.tips.items():
        for sample in tip.samples:
            answer = tip.answer(sample)
            yield slip_topic(serial), _recorded(answer.angle_deg, answer.sigma_deg, sample)
    for fused in measurement.angle.fused:
        yield FUSED_TOPIC, _recorded(fused.angle_deg, fused.sigma_deg, fused)
    for time_ns, angle, sigma in zip(truth.time_ns, truth.angle_deg, truth.sigma_deg, strict=True):
        yield TRUTH_TOPIC, RecordedAngle(int(time_ns), float(angle), float(sigma), State.TRACKING.value)


def _recorded(angle: float | None, sigma: float | None, sample: SlipSample | FusedSample) -> RecordedAngle:
    area = sample.contact_area_px if isinstance(sample, SlipSample) else None
    return RecordedAngle(sample.time_ns, angle, sigma, sample.state.value, area)


def recorded_truth(recording: Path) -> TruthSeries:
    """Read the markers' angle of a recorded lift; the reasons of refused frames are not recorded.

    Raises `SessionError`.
    """
    angles = recorded_angles(recording, TRUTH_TOPIC)[TRUTH_TOPIC]
    return TruthSeries(
        np.array([angle.time_ns for angle in angles], np.int64),
        np.array([angle.angle_deg for angle in angles], float),
        np.array([angle.sigma_deg for angle in angles], float),
        0.0,
        None,
        {},
    )


MOST_OFF_RATE = 0.05
"""Largest relative difference without a warning. Clocks of cameras are off by 1e-4; a delay that varies by
0.05 s over the 5 s of a lift is 0.01."""
LEAST_FRAMES, LEAST_SPAN_S = 30, 2.0
"""Fewest frames, and shortest time, from which a rate is computed."""


class StampRates(LiftEvents):
    """Compares the speed of each source's time stamps with the bench's clock, from the frames' delays."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._times_ns: dict[str, list[tuple[int, int]]] = {}

    def frame(self, frame: Frame) -> None:
        """Note when a frame was delivered."""
        self._times_ns.setdefault(frame.serial, []).append((frame.time_ns, self._clock.now_ns()))

    def amiss(self) -> dict[str, float]:
        """Return the speed of the stamps divided by that of the clock, by serial, where it is not about 1.

        A loaded computer delivers the frames of all sources later and later: what they have in common is not
        due to their clocks.
        """
        growth = {serial: g for serial, times in self._times_ns.items() if (g := _growth(times)) is not None}
        common = max(0.0, min(growth.values(), default=0.0)) if len(growth) > 1 else 0.0
        rates = {serial: 1.0 - (g - common) for serial, g in growth.items()}
        return {serial: round(rate, 3) for serial, rate in rates.items() if abs(rate - 1.0) > MOST_OFF_RATE}


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


class LatencyProbe(LiftEvents):
    """Measures when each frame has been recorded and estimated. It must be the last observer.

    clock: the bench's clock, which also gives the capture times.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._phase = Phase.REFERENCE
        self._late_ns: dict[str, list[int]] = {}

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase."""
        self._phase = phase

    def frame(self, frame: Frame) -> None:
        """Measure the time since the capture of a frame."""
        if self._phase in (Phase.LIFT, Phase.HOLD):
            self._late_ns.setdefault(frame.serial, []).append(self._clock.now_ns() - frame.time_ns)

    def times(self) -> dict[str, LatencyTimes]:
        """Return the latency over phases B and C, by serial, ms: median, 95th, 99th percentile, maximum."""
        return {
            serial: LatencyTimes(*(np.percentile(late, (50, 95, 99, 100)) * 1e3 / NS_PER_S).tolist())
            for serial, late in self._late_ns.items()
        }
