"""What is measured during one lift: the observer that records, estimates and compares.

The same object watches a lift as it happens and a recording of it, so that a replay gives the
same results bit for bit.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace

from drivers.clock import to_ns
from drivers.errors import StaleFrameError
from drivers.tally import FrameTally
from drivers.types import ArmState, Frame, GripperState, Pose
from protocols.observer import Phase
from protocols.reaction import ReactionStep
from protocols.slip_trial import SETTLE_S
from rig.lift.fusion import FusedSample, fuse
from rig.lift.marker_distance import ExpectedDistance
from rig.lift.marker_truth import MarkerTruth, TruthSeries
from rig.lift.onset import OnsetAlarm
from rig.lift.slip_watch import SlipWatch
from rig.lift.tip_track import ZERO_S, TipTrack
from rig.sessions.images import stored
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC, LiftRecorder, RecordedAngle, slip_topic
from rig.sessions.records import MarkerDistance
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import SlipSample, State

OUTLINE_EVERY_S = 0.1
OUTLINE_STEP = 4
"""Points of an outline lie a pixel apart; each so-many-th is kept."""
FALLEN_S = 0.2
CAMERA = "camera"
"""The external camera's name among the sources that are counted; fingertips go by serial."""


_log = logging.getLogger("rig.lift")


class LiftMeasurement:
    """Watches one lift.

    signs: of the fingertips by serial. aspects: their pixels' width over height, where known.
    time_shift_s: added to a sensor's times, by serial, where its clock was calibrated. distance: how far
    from the camera the markers should be, where that is to be checked. watch: looks for slips that ask
    for a reaction, where there are any. `tallies` counts each source's frames, by serial and `CAMERA`.
    """

    def __init__(
        self,
        signs: Mapping[str, int],
        estimator: EstimatorChoice,
        truth: MarkerTruth,
        recorder: LiftRecorder | None = None,
        aspects: Mapping[str, float | None] | None = None,
        time_shift_s: Mapping[str, float] | None = None,
        distance: ExpectedDistance | None = None,
        watch: SlipWatch | None = None,
    ) -> None:
        self.tips = {serial: TipTrack(sign) for serial, sign in signs.items()}
        self.tallies = {source: FrameTally() for source in (*signs, CAMERA)}
        self.truth = truth
        self.watch = watch
        self.risen = True
        """Whether the lift went to its full height."""
        self._distance = distance
        self.fused: list[FusedSample] = []
        self.alarm = OnsetAlarm()
        self.phases: dict[Phase, int] = {}
        self._estimator = estimator
        self._aspects = aspects or {}
        self._shift_ns = {serial: to_ns(shift) for serial, shift in (time_shift_s or {}).items()}
        self._recorder = recorder
        self._tcp: Pose | None = None

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase: references end with A, zeros are taken at B."""
        self.phases[phase] = time_ns
        if self._recorder:
            self._recorder.phase(phase, time_ns)
        if phase is Phase.GRASP:
            self._make_estimators()
        elif phase is Phase.LIFT:
            self._set_zero(time_ns)
        elif phase is Phase.HOLD:
            self.risen = self.watch is None or not self.watch.ended
        elif phase is Phase.LOWER:
            # Not before: it takes as long as a frame, and an angle from the fingertips would come late.
            self.truth.measure_zero()

    def arm(self, state: ArmState) -> None:
        """Take the arm's state: the wrist's turn is not the object's, and some estimators feel through it."""
        self._tcp = state.base_T_tcp
        for tip in self.tips.values():
            if tip.estimator is not None:
                tip.estimator.arm(state)
        if self._recorder:
            self._recorder.arm(state)

    def gripper(self, state: GripperState) -> None:
        """Record the gripper's state."""
        if self._recorder:
            self._recorder.gripper(state)

    def frame(self, frame: Frame) -> None:
        """Take a frame: to the record first, then to the estimator or to the truth."""
        frame, jpeg = stored(frame)
        if self._recorder:
            self._recorder.image(frame, jpeg)
        if frame.serial in self._shift_ns:
            frame = replace(frame, time_ns=frame.time_ns + self._shift_ns[frame.serial])
        tip = self.tips.get(frame.serial)
        tally = self.tallies[CAMERA if tip is None else frame.serial]
        tally.add(frame)
        if tally.out_of_time:
            # kept in the recording; nothing can be said of a moment that nobody knows
            _log.warning("%s: frame %d says a time that cannot be: left out", frame.serial, frame.sequence)
        elif tip is not None:
            self._tactile(tip, frame)
        elif self._tcp is not None and self._since_grasp(frame):
            self.truth.update(frame.image, frame.time_ns, self._tcp)

    def _since_grasp(self, frame: Frame) -> bool:
        """Whether a frame was captured after the grasp; one may come after it that was captured before."""
        grasp_ns = self.phases.get(Phase.GRASP)
        return grasp_ns is not None and frame.time_ns >= grasp_ns

    def touching(self, serial: str) -> bool:
        """Whether a fingertip has shown contact in its last frames."""
        return self.tips[serial].touch.sure

    def slip_ns(self) -> int | None:
        """When the frame was captured that asks for a reaction; None without one."""
        return None if self.watch is None else self.watch.slip_ns()

    def at_rest(self) -> bool:
        """Whether no fingertip has seen a turn for a while."""
        return self.watch is not None and self.watch.at_rest()

    def another_is_too_much(self) -> bool:
        """Whether one more slip would turn the object further than it may."""
        return self.watch is not None and self.watch.another_is_too_much()

    def reacted(self, step: ReactionStep, time_ns: int, counts: int) -> None:
        """Take a step of a reaction: to the record, then to what looks for the next slip."""
        if self._recorder:
            self._recorder.reaction(step, time_ns, counts)
        if self.watch is not None:
            self.watch.reacted(step, time_ns, counts)
        if step is ReactionStep.CLOSED:
            for tip in self.tips.values():
                if tip.estimator is not None:
                    tip.estimator.gripped_further()

    def fall_ns(self, until_ns: int) -> int | None:
        """Return when the object left the fingertips; None if they had contact shortly before `until_ns`."""
        samples = [s for tip in self.tips.values() for s in tip.samples if s.time_ns < until_ns]
        touching = [s.time_ns for s in samples if s.state is not State.NO_CONTACT]
        last = max(touching, default=min((s.time_ns for s in samples), default=until_ns))
        return last if last < until_ns - to_ns(FALLEN_S) else None

    def marker_distance(self) -> MarkerDistance | None:
        """How far the markers look and should be, where that warns; None else, or where it is not known."""
        return self._distance.warning(self.truth.distance_sides()) if self._distance else None

    def record_results(self, series: TruthSeries) -> None:
        """Add angles and states to the recording, behind the frames they came from."""
        if self._recorder is None:
            return
        for topic, angle in self.angles(series):
            self._recorder.angle(topic, angle)

    def angles(self, series: TruthSeries) -> Iterator[tuple[str, RecordedAngle]]:
        """Yield the angles of a lift as a recording keeps them, each with its topic."""
        for serial, tip in self.tips.items():
            for sample in tip.samples:
                answer = tip.answer(sample)
                yield slip_topic(serial), _recorded(answer.angle_deg, answer.sigma_deg, sample)
        for fused in self.fused:
            yield FUSED_TOPIC, _recorded(fused.angle_deg, fused.sigma_deg, fused)
        for time_ns, angle, sigma in zip(series.time_ns, series.angle_deg, series.sigma_deg, strict=True):
            yield TRUTH_TOPIC, RecordedAngle(int(time_ns), float(angle), float(sigma), State.TRACKING.value)

    def _tactile(self, tip: TipTrack, frame: Frame) -> None:
        if tip.estimator is None:
            tip.reference.append(frame.image)
            return
        if Phase.LOWER in self.phases:
            return  # recorded only: the turn of an object that is set down is not a slip
        sample = tip.estimator.update(frame.image, frame.time_ns)
        tip.samples.append(sample)
        tip.touch.update(sample.state is not State.NO_CONTACT)
        if Phase.LIFT in self.phases:
            others = [other.newest() for other in self.tips.values() if other is not tip and other.samples]
            fused = fuse(tip.newest(), others)
            self.fused.append(fused)
            self.alarm.update(fused.time_ns, fused.angle_deg, fused.rate_deg_s)
            if self.watch is not None:
                self.watch.update(frame.serial, tip.newest())
        if self.slip_ns() is None:  # an arm that is to stop waits for no picture
            self._outline(tip, frame)

    def _outline(self, tip: TipTrack, frame: Frame) -> None:
        """Keep the contact's outline now and then, for who looks at the recording; no angle depends on it."""
        due = tip.outlined_ns is None or frame.time_ns - tip.outlined_ns >= to_ns(OUTLINE_EVERY_S)
        if self._recorder is None or tip.finder is None or not due:
            return
        tip.outlined_ns = frame.time_ns
        line = tip.finder.find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]
        self._recorder.contact(frame.serial, [line] if len(line) else [], frame.time_ns)

    def _make_estimators(self) -> None:
        for serial, tip in self.tips.items():
            if not tip.reference:
                raise StaleFrameError(f"{serial}: no frame arrived before the grasp; check that it streams")
            background = mean_background(tip.reference)
            tip.estimator = self._estimator.make(background, self._aspects.get(serial), tip.sign)
            tip.finder = ContactFinder(background) if self._recorder else None
            tip.reference = []

    def _set_zero(self, time_ns: int) -> None:
        self.truth.set_zero(time_ns - to_ns(ZERO_S), time_ns, earliest_ns=time_ns - to_ns(SETTLE_S))
        for tip in self.tips.values():
            tip.set_zero(tip.samples, time_ns)
        if self.watch is not None:
            since = time_ns - to_ns(SETTLE_S)
            self.watch.begin(
                {
                    serial: [tip.answer(s) for s in tip.samples if since <= s.time_ns < time_ns]
                    for serial, tip in self.tips.items()
                }
            )


def _recorded(angle: float | None, sigma: float | None, sample: SlipSample | FusedSample) -> RecordedAngle:
    area = sample.contact_area_px if isinstance(sample, SlipSample) else None
    return RecordedAngle(sample.time_ns, angle, sigma, sample.state.value, area)
