"""Lifts as training data: wrench at the wrist, tactile frames, and the true rotation of the object."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import GraspError, InputError
from drivers.types import ArmState, Frame, Image, Pose
from protocols.observer import LiftObserver, Phase
from protocols.slip_trial import LiftPlan, run_lift
from rig.bench.learning import LearningBench, build_learning_bench
from rig.config import load_bench
from rig.experiments.grasp_plans import derived_seed
from rig.experiments.lift_plan import LiftTask, TrialSettings, plan_lift
from rig.lift.object_angle import ZERO_S
from rig.lift.recording import recorded_truth
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import phase_times, recorded_arm_states, recorded_frames
from rig.sessions.records import finished
from rig.sessions.rows import read_lifts
from rig.tactile.estimators import choose_estimator
from rig.training.examples import sized

SIGHT_HZ = 10.0
"""Rate of the training frames: consecutive frames are nearly identical."""
LiftReport = Callable[[int, int], None]
"""Takes the numbers of finished and of all simulated lifts."""
Turn = Callable[[int], float | None]
"""The object's true rotation in the hand since the start of the lift, at a time in ns: deg, counter-clockwise
as the camera sees it, None if unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class WristSeries:
    """The arm's states during one lift, from the grasp to the end of phase C.

    states: N samples. turn_deg: (N,) true rotation at each, 0 before the lift, NaN if unknown.
    rising: (N,) bool, phases B and C.
    """

    object_id: str
    states: tuple[ArmState, ...]
    turn_deg: NDArray[np.float64]
    rising: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class GelViews:
    """Tactile frames of many lifts with the image angle of the object.

    images: (N, h, w, 3) uint8 RGB. angle_deg: (N,) image angle of the object, counter-clockwise as seen,
    0 if hand and object are aligned. objects: the object's id of each.
    """

    images: Image
    angle_deg: NDArray[np.float64]
    objects: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.objects)

    def of(self, objects: Sequence[str]) -> "GelViews":
        at = np.flatnonzero(np.isin(self.objects, list(objects)))
        return GelViews(self.images[at], self.angle_deg[at], tuple(self.objects[i] for i in at))


def wrist_series(
    object_id: str, states: Sequence[ArmState], phases: dict[str, int], turn: Turn
) -> WristSeries:
    """Combine the samples of one lift with the ground truth."""
    lift_ns = phases[Phase.LIFT]
    kept = tuple(s for s in states if phases[Phase.GRASP] <= s.time_ns < phases[Phase.LOWER])
    rising = np.array([s.time_ns >= lift_ns for s in kept], bool)
    turns = [turn(s.time_ns) if late else 0.0 for s, late in zip(kept, rising, strict=True)]
    return WristSeries(object_id, kept, np.array(turns, np.float64), rising)  # None becomes NaN


def labelled_views(
    frames: Iterator[Frame], sign: int, hand_turn_deg: float, phases: dict[str, int], turn: Turn
) -> Iterator[tuple[Frame, float]]:
    """Yield one fingertip's frames from just before the lift to the end of phase C, with their angle.

    hand_turn_deg: rotation of the hand at the grasp, see `hand_turn_deg`.
    """
    for frame in frames:
        if not phases[Phase.LIFT] - to_ns(ZERO_S) <= frame.time_ns < phases[Phase.LOWER]:
            continue
        turned = turn(frame.time_ns) if frame.time_ns >= phases[Phase.LIFT] else 0.0
        if turned is not None:
            yield frame, sign * (turned - hand_turn_deg)


def stacked_views(views: Sequence[tuple[str, Image, float]], where: str) -> GelViews:
    """Stack views (object, image, angle) of one size. Raises `InputError` if there are none."""
    if not views:
        raise InputError(
            f"{where}: no tactile frame with a true angle: were the markers in the camera's view?"
        )
    return GelViews(
        np.stack([image for _, image, _ in views]),
        np.array([angle for *_, angle in views], np.float64),
        tuple(name for name, *_ in views),
    )


def hand_turn_deg(base_T_tcp: Pose) -> float:  # noqa: N803
    """Return a downward hand's angle about the closing axis (base -y), deg, counter-clockwise as seen."""
    x_axis = base_T_tcp.rotation.apply([1.0, 0.0, 0.0])
    return math.degrees(math.atan2(float(x_axis[2]), float(x_axis[0])))


@dataclass(frozen=True, slots=True, eq=False)
class StoredLift:
    """One accepted lift of a trial session. signs: of the fingertips by serial."""

    object_id: str
    recording: Path
    signs: Mapping[str, int]
    phases: dict[str, int]
    turn: Turn

    def wrist(self) -> WristSeries:
        """Return the arm's states. Raises `SessionError` for a damaged recording."""
        return wrist_series(self.object_id, list(recorded_arm_states(self.recording)), self.phases, self.turn)

    def views(self, size: tuple[int, int]) -> Iterator[tuple[str, Image, float]]:
        """Yield object, frame of (width, height) `size` and angle, both fingertips. Raises `SessionError`."""
        grasped = next(
            s for s in recorded_arm_states(self.recording) if s.time_ns >= self.phases[Phase.GRASP]
        )
        hand = hand_turn_deg(grasped.base_T_tcp)
        for serial, sign in self.signs.items():
            frames = _thinned(recorded_frames(self.recording, serial))
            for frame, angle in labelled_views(frames, sign, hand, self.phases, self.turn):
                yield self.object_id, sized(frame.image, size), angle


def stored_lifts(folders: Sequence[Path]) -> list[StoredLift]:
    """Open the accepted lifts of trial sessions. Raises `InputError` or `SessionError`."""
    lifts = []
    for folder in folders:
        why = "angles are learnt from lifts, so give sessions of rig trial"
        manifest = read_manifest_of(folder, TrialManifest, why)
        rows = finished(read_lifts(folder))
        for recording, object_id in ((folder / row.recording, row.object) for row in rows):
            phases, turn = phase_times(recording), recorded_truth(recording).at_ns
            lifts.append(StoredLift(object_id, recording, manifest.signs, phases, turn))
    if not lifts:
        raise InputError(f"{', '.join(map(str, folders))}: no finished lift: run rig trial first")
    return lifts


def _thinned(frames: Iterator[Frame]) -> Iterator[Frame]:
    due_ns = 0
    for frame in frames:
        if frame.time_ns >= due_ns:
            due_ns = frame.time_ns + to_ns(1.0 / SIGHT_HZ)
            yield frame


TOUCH_N = 0.06
"""Approximate force at which a fingertip shows contact."""


def simulated_wrists(objects: Sequence[str], lifts: int, seed: int, report: LiftReport) -> list[WristSeries]:
    """Carry out `lifts` lifts of each object without tactile images; return the arm's states.

    Equal seeds give equal lifts.
    """
    return [
        wrist_series(plan.object_id, seen.states, seen.phases, seen.turn_deg)
        for plan, seen, _ in _lifts(objects, lifts, seed, None, report)
    ]


def simulated_views(
    objects: Sequence[str], lifts: int, seed: int, size: tuple[int, int], report: LiftReport
) -> Iterator[tuple[str, Image, float]]:
    """Carry out lifts; yield object, frame at (width, height) `size` and angle of both fingertips."""
    for plan, seen, bench in _lifts(objects, lifts, seed, SIGHT_HZ, report):
        hand = hand_turn_deg(plan.base_T_grasp)
        for tip in bench.fingertips:
            frames = iter(seen.frames[tip.sensor.serial])
            for frame, angle in labelled_views(frames, tip.sign, hand, seen.phases, seen.turn_deg):
                yield plan.object_id, sized(frame.image, size), angle


def _lifts(
    objects: Sequence[str], lifts: int, seed: int, sight_hz: float | None, report: LiftReport
) -> Iterator[tuple[LiftPlan, "_Seen", Bench]]:
    config = load_bench("fake")
    settings = TrialSettings(config, seed, choose_estimator())
    tasks = [LiftTask(0, object_id, lift) for object_id in objects for lift in range(1, lifts + 1)]
    for done, task in enumerate(tasks, 1):
        made = build_learning_bench(config, derived_seed(seed, "learnt", task.object_id, task.lift), sight_hz)
        plan = plan_lift(settings, task, made.bench.base_T_table)
        seen = _Seen(made)
        try:
            with made.bench.connected():
                made.bench.gripper.activate()
                made.place(plan.object_id)
                run_lift(made.bench, plan, seen)
        except GraspError:  # no contact: nothing to learn
            continue
        finally:
            report(done, len(tasks))
        yield plan, seen, made.bench


@dataclass(slots=True)
class _Seen(LiftObserver):
    """Stores the events of one lift, and the object's rotation in the hand at each sample and frame."""

    made: LearningBench
    phases: dict[str, int] = field(default_factory=dict)
    states: list[ArmState] = field(default_factory=list)
    frames: dict[str, list[Frame]] = field(default_factory=dict)
    _turns_deg: dict[int, float] = field(default_factory=dict)

    def phase(self, phase: Phase, time_ns: int) -> None:
        self.phases[phase] = time_ns
        self._note(time_ns)

    def frame(self, frame: Frame) -> None:
        self.frames.setdefault(frame.serial, []).append(frame)
        self._note(frame.time_ns)

    def arm(self, state: ArmState) -> None:
        self.states.append(state)
        self._note(state.time_ns)

    def touching(self, serial: str) -> bool:
        """Whether the fingers press on the object."""
        return self.made.force_n(self.made.bench.clock.now_ns()) >= TOUCH_N

    def turn_deg(self, time_ns: int) -> float:
        """The object's rotation in the hand since the start of the lift, at the time of an event."""
        return self._turns_deg[time_ns] - self._turns_deg[self.phases[Phase.LIFT]]

    def _note(self, time_ns: int) -> None:
        self._turns_deg[time_ns] = self.made.turn_deg(time_ns)
