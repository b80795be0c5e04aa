"""Lifts as training data: wrench at the wrist, tactile frames, and the true rotation of the object.

Used by `tools/angle_nets.py`. To train on lifts, run `python tools/train_angle.py --help`.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.errors import GraspError, InputError
from drivers.types import ArmState, Frame, Image, Pose
from learning_bench import LearningBench, build_learning_bench
from protocols.observer import LiftObserver, Phase
from protocols.slip_trial import run_lift
from rig.config import load_bench
from rig.experiments.lift_plan import LiftTask, TrialSettings, derived_seed, plan_lift
from rig.lift.object_angle import ZERO_S
from rig.lift.recording import recorded_truth
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import phase_times, recorded_arm_states, recorded_frames
from rig.sessions.records import accepted_lifts
from rig.sessions.rows import read_lifts
from rig.tactile.estimators import choose_estimator
from rig.tactile.peers.learned import WrenchSteps
from rig.training.examples import resize

SIGHT_HZ = 10.0
"""Rate of the training frames: consecutive frames are nearly identical."""
TOUCH_N = 0.06
"""Approximate force at which a fingertip shows contact."""
AT_REST = 0.1
"""Weight of time steps before the lift, whose angle is 0."""
LiftReport = Callable[[int, int], None]
"""Takes the numbers of finished and of all simulated lifts."""
Turn = Callable[[int], float | None]
"""The object's true rotation in the hand since the start of the lift, at a time in ns: deg, counter-clockwise
as the camera sees it, None if unknown."""


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


def stack_views(views: Sequence[tuple[str, Image, float]], where: str) -> GelViews:
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


@dataclass(frozen=True, slots=True, eq=False)
class LearntLift:
    """One lift as training data, stored or simulated.

    signs: of the fingertips by serial. phases: their start times, ns. states: yields all samples of the arm.
    frames: yields the frames of a serial. base_T_grasp: pose of the hand at the grasp, None for that of the
    first sample after it.
    """

    object_id: str
    signs: Mapping[str, int]
    phases: dict[str, int]
    turn: Turn
    states: Callable[[], Iterable[ArmState]]
    frames: Callable[[str], Iterable[Frame]]
    base_T_grasp: Pose | None = None  # noqa: N815

    def steps(self) -> NDArray[np.float32]:
        """Return the time steps of the wrist network from the grasp to the end of phase C, (T, 8).

        Columns: wrench (N, N m; see `WrenchSteps`), true rotation (deg, 0 before the lift), and weight: 1 in
        phases B and C, `AT_REST` before, 0 without ground truth.
        """
        lift_ns, grasp_ns, lower_ns = (self.phases[p] for p in (Phase.LIFT, Phase.GRASP, Phase.LOWER))
        steps, rows = WrenchSteps(), []
        for state in self.states():
            if grasp_ns <= state.time_ns < lower_ns and (wrench := steps.add(state)) is not None:
                rising = state.time_ns >= lift_ns
                turn = self.turn(state.time_ns) if rising else 0.0
                weight = 0.0 if turn is None else 1.0 if rising else AT_REST
                rows.append((*wrench, turn or 0.0, weight))
        return np.array(rows, np.float32).reshape(-1, 8)

    def views(self, size: tuple[int, int]) -> Iterator[tuple[str, Image, float]]:
        """Yield object, frame of (width, height) `size` and image angle, of both fingertips.

        The frames begin just before the lift and end with phase C. Raises `SessionError`.
        """
        lift_ns, grasp_ns, lower_ns = (self.phases[p] for p in (Phase.LIFT, Phase.GRASP, Phase.LOWER))
        pose = self.base_T_grasp or next(s for s in self.states() if s.time_ns >= grasp_ns).base_T_tcp
        # the downward hand's angle about the closing axis (base -y), counter-clockwise as seen
        x_axis = pose.rotation.apply([1.0, 0.0, 0.0])
        hand = math.degrees(math.atan2(float(x_axis[2]), float(x_axis[0])))
        for serial, sign in self.signs.items():
            for frame in self.frames(serial):
                if not lift_ns - to_ns(ZERO_S) <= frame.time_ns < lower_ns:
                    continue
                turned = self.turn(frame.time_ns) if frame.time_ns >= lift_ns else 0.0
                if turned is not None:
                    yield self.object_id, resize(frame.image, size), sign * (turned - hand)


def stored_lifts(folders: Sequence[Path]) -> list[LearntLift]:
    """Open the accepted lifts of trial sessions. Raises `InputError` or `SessionError`."""
    lifts = []
    for folder in folders:
        why = "angles are learnt from lifts, so give sessions of rig trial"
        manifest = read_manifest_of(folder, TrialManifest, why)
        for row in accepted_lifts(read_lifts(folder)):
            path = folder / row.recording
            phases, turn = phase_times(path), recorded_truth(path).at_ns
            states, frames = partial(recorded_arm_states, path), partial(_thin, path)
            lifts.append(LearntLift(row.object, manifest.signs, phases, turn, states, frames))
    if not lifts:
        raise InputError(f"{', '.join(map(str, folders))}: no finished lift: run rig trial first")
    return lifts


def _thin(recording: Path, serial: str) -> Iterator[Frame]:
    due_ns = 0
    for frame in recorded_frames(recording, serial):
        if frame.time_ns >= due_ns:
            due_ns = frame.time_ns + to_ns(1.0 / SIGHT_HZ)
            yield frame


def simulated_lifts(
    objects: Sequence[str], lifts: int, seed: int, report: LiftReport, sight_hz: float | None = None
) -> Iterator[LearntLift]:
    """Carry out `lifts` lifts of each object on a simulated bench.

    Equal seeds give equal lifts on one computer. The protocol, plan, steps and waiting times are those of
    `rig trial`. The camera is not rendered, because the ground truth comes from the simulated world.
    sight_hz: rate of the tactile frames; None for none.
    """
    config = load_bench("fake")
    settings = TrialSettings(config, seed, choose_estimator())
    tasks = [LiftTask(0, object_id, lift) for object_id in objects for lift in range(1, lifts + 1)]
    for done, task in enumerate(tasks, 1):
        made = build_learning_bench(config, derived_seed(seed, "learnt", task.object_id, task.lift), sight_hz)
        plan = plan_lift(settings, task, made.bench.base_T_table)
        seen = _Seen(made)
        try:
            with made.bench.connection():
                made.bench.gripper.activate()
                made.place(plan.object_id)
                run_lift(made.bench, plan, seen)
        except GraspError:  # no contact: nothing to learn
            continue
        finally:
            report(done, len(tasks))
        signs = {tip.sensor.serial: tip.sign for tip in made.bench.fingertips}
        pose, frames = plan.base_T_grasp, seen.frames.__getitem__
        states = partial(iter, seen.states)
        yield LearntLift(plan.object_id, signs, seen.phases, seen.turn_deg, states, frames, pose)


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
