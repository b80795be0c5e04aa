"""Plan a lift: its task, the settings of a trial, the plan drawn from the seed, and the reaction to slip.

A replay has the settings of a finished trial, from its manifest. Poses of a recording use the same grasps.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.errors import InputError, OutOfLimitsError
from drivers.types import Pose
from protocols.grasps import GraspFile, Position, find_grasp_file
from protocols.reaction import FIRST_CLOSING_M, MOST_REACTIONS, ReactionKind
from protocols.slip_trial import LiftPlan
from protocols.steps import require_room
from rig.bench.assembly import TOOL_DOWN
from rig.bench.twins import refuse_undrawn
from rig.config import BenchConfig
from rig.experiments.attempts import Task
from rig.lift.measurement import LiftMeasurement
from rig.lift.slip_watch import SlipSettings, sigmas_for
from rig.sessions.files import recording_file
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.records import Lift, LiftOutcome
from rig.tactile.estimators import WITH_RATE, EstimatorChoice, choose_estimator, stored_choice

LEAST_LIFT = 0.4
"""Smallest fraction of the object file's lift height that is drawn; the largest is 1."""
MAX_TRIAL_TURN_DEG = 15.0
"""Largest random angle of the hand in a trial, to either side."""


def grasp_pose(base_T_table: Pose, place: Position, turn_deg: float) -> Pose:  # noqa: N803
    """Return `base_T_tcp` at a position along the object, with the hand rotated about the closing axis.

    turn_deg: in addition to the position's own angle, counter-clockwise in the external camera's view (about
    the base's -y axis).
    """
    turned = Rotation.from_euler("y", -(place.turn_deg + turn_deg), degrees=True) * TOOL_DOWN
    return Pose.from_rotation(
        base_T_table.translated(x_m=place.offset_m, z_m=place.height_m).position_m, turned
    )


def refuse_impossible(bench: BenchConfig, grasps: GraspFile, place: Position) -> None:
    """Raise `InputError` for an object too wide for the fingers, or not drawable on a simulated bench."""
    refuse_undrawn(bench, grasps)
    try:
        require_room(bench.gripper_spec(), place.width_m)
    except OutOfLimitsError as error:
        raise InputError(f"object {grasps.id} {grasps.name}, {place.name}: {error}") from error


def derived_seed(seed: int, *what: str | int, attempt: int = 0) -> int:
    """Return a seed of 48 bits for a task, e.g. `derived_seed(0, "t1", 3)`.

    attempt: each further attempt, from 1, has a different seed.
    """
    text = "/".join(str(part) for part in (seed, *what, *([attempt] if attempt else [])))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")


@dataclass(frozen=True, slots=True)
class LiftTask(Task):
    """One lift to do. lift: its number for its object, from 1."""

    lift: int

    @property
    def name(self) -> str:
        return f"{self.object_id}/{self.lift}"

    @property
    def recording(self) -> str:
        return recording_file(self.number, self.attempt)


def all_tasks(objects: Sequence[str], lifts: int) -> list[LiftTask]:
    """Return every lift of a trial, object by object."""
    each = ((object_id, lift) for object_id in objects for lift in range(1, lifts + 1))
    return [LiftTask(number, *which) for number, which in enumerate(each, start=1)]


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Settings that all lifts of a trial share.

    markers_only: store only the surroundings of the markers of the external camera's pictures.
    """

    bench: BenchConfig
    seed: int
    estimator: EstimatorChoice
    realtime: bool = False
    react: ReactionKind = ReactionKind.NONE
    slip: SlipSettings = field(default_factory=SlipSettings)
    markers_only: bool = False


def plan_lift(settings: TrialSettings, task: LiftTask, base_T_table: Pose) -> LiftPlan:  # noqa: N803
    """Draw position, angle, grip and height of a lift from its seed and its object's file.

    Raises `InputError` for an object that cannot be lifted here.
    """
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    rng = np.random.default_rng(derived_seed(settings.seed, "plan", task.object_id, task.lift))
    places = [position for position in grasps.position if position.lift_height_m > 0.0]
    if not places:
        raise InputError(
            f"object {grasps.id} {grasps.name} has no position with a lift_height_m above 0, so a trial "
            "cannot lift it: write how high, as lift_height_m = 0.05"
        )
    place = places[int(rng.integers(len(places)))]
    low, high = map(settings.bench.gripper_spec().steps_for, grasps.grip_m)
    turn = float(rng.uniform(-MAX_TRIAL_TURN_DEG, MAX_TRIAL_TURN_DEG))
    grip_steps = int(rng.integers(low, high + 1))
    refuse_impossible(settings.bench, grasps, place)
    return LiftPlan(
        object_id=grasps.id,
        object_name=grasps.name,
        position=place.name,
        base_T_grasp=grasp_pose(base_T_table, place, turn),
        width_m=place.width_m,
        grip_steps=grip_steps,
        lift_height_m=place.lift_height_m * float(rng.uniform(LEAST_LIFT, 1.0)),
    )


def planned_lift(settings: TrialSettings, task: LiftTask) -> tuple[LiftPlan, Lift]:
    """Return the plan of a lift, and its record before it is carried out. Raises `InputError`."""
    plan = plan_lift(settings, task, Pose(settings.bench.require("table").position_m))
    return plan, Lift(
        number=task.number,
        attempt=task.attempt,
        object=task.object_id,
        name=plan.object_name,
        lift=task.lift,
        position=plan.position,
        accepted=False,
        outcome=LiftOutcome.FAULT,
        fault="not carried out",
        grip_counts=plan.grip_steps,
        lift_height_m=plan.lift_height_m,
        bench_s=0.0,
        seed=derived_seed(settings.seed, task.object_id, task.lift, attempt=task.attempt),
        simulated=settings.bench.simulated,
        recording=task.recording,
        react=settings.react,
    )


def new_measurement(settings: TrialSettings) -> LiftMeasurement:
    """Return the measurement of one lift, the same for a live lift and for its replay."""
    slip = None if settings.react is ReactionKind.NONE else settings.slip
    return LiftMeasurement(settings.bench, settings.estimator, slip)


def require_reaction(settings: TrialSettings, objects: Iterable[str]) -> None:
    """Raise `InputError` if a trial cannot or may not react, because of bench, estimator, rate or object."""
    if settings.react is ReactionKind.NONE:
        return
    bench, estimator = settings.bench, settings.estimator.name
    if not bench.reacts:
        raise InputError(
            f"--react {settings.react}: bench '{bench.name}' does not permit it: the arm would stop and the "
            "fingers would close automatically; if that is safe, write reactions_allowed = true in its file"
        )
    if estimator not in WITH_RATE:
        raise InputError(
            f"--react {settings.react}: estimator '{estimator}' estimates no angular rate, so no slip "
            f"in time; use {', '.join(WITH_RATE)}"
        )
    for tactile in bench.tactile:
        sigmas_for(settings.slip.false_alarms_per_hour / len(bench.tactile), tactile.rate_hz)
    if settings.react is ReactionKind.TIGHTEN:
        for object_id in objects:
            find_grasp_file(object_id, bench.objects).require_largest_grip()


def describe_reaction(settings: TrialSettings, objects: Iterable[str]) -> list[str]:
    """Return lines that describe a trial's reaction to slip; none without a reaction."""
    if settings.react is ReactionKind.NONE:
        return []
    limit = settings.slip.max_turn_deg
    when = "" if limit is None else f" that would rotate the object by more than {limit:g} degrees"
    head = f"On a slip{when} the arm stops automatically, at most {MOST_REACTIONS} times per lift,"
    if settings.react is ReactionKind.STOP:
        return [f"{head} and holds the object there."]
    if settings.react is ReactionKind.LOWER:
        return [f"{head} and sets the object down."]
    grasps = [find_grasp_file(object_id, settings.bench.objects) for object_id in objects]
    largest = ", ".join(f"{g.id} {g.name} {1e3 * g.require_largest_grip():.1f}" for g in grasps)
    return [
        f"{head} the fingers close step by step ({1e3 * FIRST_CLOSING_M:.1f} mm, then twice as far each "
        f"time), and the lift goes on. At most, in mm past contact: {largest}."
    ]


@dataclass(frozen=True, slots=True)
class StoredTrial:
    """A trial's folder, its manifest, and the settings of a replay.

    settings: those of the trial, or with another estimator.
    """

    folder: Path
    manifest: TrialManifest
    settings: TrialSettings

    @property
    def own_estimator(self) -> bool:
        """Whether the settings have the estimator of the trial itself."""
        stored = self.manifest
        return self.settings.estimator == stored_choice(stored.estimator, stored.window, stored.skip)


def stored_trial(folder: Path, estimator: str | None = None, window: int | None = None) -> StoredTrial:
    """Read a trial's manifest and choose the estimator as `trial_of` does. Raises `SessionError`."""
    manifest = read_manifest_of(folder, TrialManifest, "only trials have lifts to replay")
    return trial_of(folder, manifest, estimator, window)


def trial_of(
    folder: Path, manifest: TrialManifest, estimator: str | None = None, window: int | None = None
) -> StoredTrial:
    """Return a trial with the settings of a replay. estimator, window: those of the trial if None.

    A user-defined estimator is imported only if it is named here. If only the session names it,
    `settings.estimator` cannot be created. Raises `InputError` for an unknown estimator or window.
    """
    if estimator is None:
        choice = stored_choice(manifest.estimator, window or manifest.window, manifest.skip)
    elif estimator == manifest.estimator:
        choice = choose_estimator(estimator, window or manifest.window, manifest.skip)
    else:  # with its usual window
        choice = choose_estimator(estimator, window)
    slip = SlipSettings(manifest.false_alarms_per_hour, manifest.max_turn_deg)
    settings = TrialSettings(manifest.config, manifest.seed, choice, react=manifest.react, slip=slip)
    return StoredTrial(folder, manifest, settings)
