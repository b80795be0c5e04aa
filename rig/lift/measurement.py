"""Measure one lift: estimate the angle from each fingertip, and the true angle from the markers.

The same class observes a live lift and its recording, so a replay gives bitwise the same results.
"""

import logging
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.markers.angle import MarkerAngle
from calibration.markers.tracker import MarkerTracker
from drivers.clock import to_ns
from drivers.errors import StaleFrameError
from drivers.tally import FrameTally
from drivers.types import ArmState, Frame, Image, Pose
from protocols.observer import LiftObserver, Phase, ReactionStep
from protocols.slip_trial import SETTLE_S
from rig.config import BenchConfig
from rig.lift.marker_truth import MarkerTruth
from rig.lift.object_angle import ZERO_S, ObjectAngle
from rig.lift.slip_watch import SlipSettings, SlipWatch
from rig.sessions.records import StageTimes
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.gate import TouchDebounce
from rig.tactile.contact.untouched import Comparison
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import State, TactileEstimator

FALLEN_S = 0.2
"""An object without contact for this long at the end of a lift has fallen."""
CAMERA = "camera"
"""Name of the external camera among the counted sources; fingertips are named by serial."""

_log = logging.getLogger("rig.lift")


@dataclass(slots=True)
class _Tip:
    """One fingertip's estimator, created at the grasp from the reference frames before it.

    seen: finds the contact if the estimator is a lab's own, on which no motion may depend.
    """

    reference: list[Image] = field(default_factory=list)
    estimator: TactileEstimator | None = None
    seen: Comparison | None = None
    touch: TouchDebounce = field(default_factory=TouchDebounce)


class LiftMeasurement(LiftObserver):
    """Measures one lift, on a bench with its calibrations in use.

    slip: when to react to a slip; None without reactions. `watch` detects these slips. `tallies` counts the
    frames of each source, by serial and `CAMERA`. `backgrounds` has the no-contact frame of each fingertip
    from phase A on. `risen`: whether the lift reached its full height.
    """

    def __init__(
        self, bench: BenchConfig, estimator: EstimatorChoice, slip: SlipSettings | None = None
    ) -> None:
        camera, signs = bench.require("camera"), {tactile.serial: tactile.sign for tactile in bench.tactile}
        markers = MarkerTracker(camera.marker_ids, camera.marker_dictionary)
        angle = MarkerAngle(markers, bench.camera_model())
        self.truth = MarkerTruth(angle, bench.base_T_camera(), bench.calibrations.camera_turn_sigma_rad)
        self.angle = ObjectAngle(signs)
        self.tallies = {source: FrameTally() for source in (*signs, CAMERA)}
        self.watch = None if slip is None else SlipWatch(slip)
        self.backgrounds: dict[str, Image] = {}
        self.phases: dict[Phase, int] = {}
        self.risen = True
        self._tips = {serial: _Tip() for serial in signs}
        self.bench, self._estimator = bench, estimator
        self._shift_ns = {serial: to_ns(s) for serial, s in bench.calibrations.time_shift_s.items()}
        self._tcp: Pose | None = None

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Begin a phase: the reference frames end with phase A, the zeros are set at phase B."""
        self.phases[phase] = time_ns
        if phase is Phase.GRASP:
            self._make_estimators()
        elif phase is Phase.LIFT:
            self._set_zero(time_ns)
        elif phase is Phase.HOLD:
            self.risen = self.watch is None or not self.watch.ended
        elif phase is Phase.LOWER:
            # Not earlier: it takes as long as a frame, and would delay an angle of the fingertips.
            self.truth.measure_zero()

    def arm(self, state: ArmState) -> None:
        """Process the arm's state: its rotation is subtracted, and some estimators use its wrench."""
        self._tcp = state.base_T_tcp
        for tip in self._tips.values():
            if tip.estimator is not None:
                tip.estimator.arm(state)

    def frame(self, frame: Frame) -> None:
        if frame.serial in self._shift_ns:
            frame = replace(frame, time_ns=frame.time_ns + self._shift_ns[frame.serial])
        tip = self._tips.get(frame.serial)
        tally = self.tallies[CAMERA if tip is None else frame.serial]
        tally.add(frame)
        if tally.out_of_time:
            # It is recorded, but its true time is unknown, so it cannot be estimated.
            _log.warning("%s: frame %d has an implausible time: left out", frame.serial, frame.sequence)
        elif tip is not None:
            self._tactile(tip, frame)
        elif self._tcp is not None and Phase.GRASP in self.phases:
            if frame.time_ns >= self.phases[Phase.GRASP]:  # an earlier frame may arrive after the grasp
                self.truth.update(frame.image, frame.time_ns, self._tcp)

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        if self.watch is not None:
            self.watch.add_step(step, time_ns, position)
        if step is ReactionStep.CLOSED:
            for tip in self._tips.values():
                if tip.estimator is not None:
                    tip.estimator.gripped_further()

    def touching(self, serial: str) -> bool:
        return self._tips[serial].touch.sure

    def fall_ns(self, until_ns: int) -> int | None:
        """Return when the object left the fingertips; None if they had contact shortly before `until_ns`."""
        samples = [s for s in self.angle.samples if s.time_ns < until_ns]
        touching = [s.time_ns for s in samples if s.state is not State.NO_CONTACT]
        last = max(touching, default=min((s.time_ns for s in samples), default=until_ns))
        return last if last < until_ns - to_ns(FALLEN_S) else None

    def stage_times(self) -> dict[str, StageTimes]:
        """Return the computing time per stage and frame with contact, ms: median, 95th, 99th percentile."""
        stages: dict[str, list[float]] = {}
        for spent_s in (sample.stage_s for sample in self.angle.samples if sample.estimated):
            for stage, time_s in {**spent_s, "total": sum(spent_s.values())}.items():
                stages.setdefault(stage, []).append(time_s * 1e3)
        return {name: StageTimes(*np.percentile(ms, [50, 95, 99]).tolist()) for name, ms in stages.items()}

    def _tactile(self, tip: _Tip, frame: Frame) -> None:
        if tip.estimator is None:
            tip.reference.append(frame.image)
            return
        if Phase.LOWER in self.phases:
            return  # the rotation of an object that is set down is not slip
        sample = tip.estimator.update(frame.image, frame.time_ns)
        own = sample.state is not State.NO_CONTACT
        contact = own if tip.seen is None else tip.seen.region(frame.image) is not None
        tip.touch.update(contact and sample.state is not State.FROZEN)
        self.angle.add(frame.serial, sample)
        if Phase.LIFT in self.phases and self.watch is not None:
            # The watch weights the fingertips by their own sigma, not by that of the rotation since the zero.
            newest = self.angle.tips[frame.serial].newest()
            self.watch.update(frame.serial, replace(newest, sigma_deg=sample.sigma_deg))

    def _make_estimators(self) -> None:
        aspects, gels = self.bench.pixel_aspects(), self.bench.calibrations.gel
        for serial, tip in self._tips.items():
            if not tip.reference:
                raise StaleFrameError(f"{serial}: no frame arrived before the grasp; check that it streams")
            background = mean_background(tip.reference)
            sign = self.angle.tips[serial].sign
            choice = replace(self._estimator, gel=gels.get(serial))
            tip.estimator = choice.make(background, aspects[serial], sign)
            tip.seen = Comparison(background) if choice.foreign else None
            self.backgrounds[serial] = background
            tip.reference = []

    def _set_zero(self, time_ns: int) -> None:
        since = time_ns - to_ns(SETTLE_S)
        self.truth.set_zero(time_ns - to_ns(ZERO_S), time_ns, earliest_ns=since)
        self.angle.begin(time_ns)
        if self.watch is not None:
            self.watch.begin(
                {
                    serial: [tip.answer(s) for s in tip.samples if since <= s.time_ns < time_ns]
                    for serial, tip in self.angle.tips.items()
                }
            )
