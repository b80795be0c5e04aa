"""One attempt at a lift, from its plan to its row: what a worker process runs."""

import time
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import CalibrationError, DeviceError, InputError
from drivers.realtime import compute_in_one_thread
from drivers.types import Pose
from protocols.grasps import find_grasp_file
from protocols.observer import LiftObserver
from protocols.reaction import Reaction, ReactionKind
from protocols.readiness import make_ready
from protocols.slip_trial import LiftPlan, run_lift
from rig.bench.source import BenchSource, FreshBenches
from rig.config import BenchConfig
from rig.experiments.attempts import Attempt, fault_text
from rig.experiments.grasp_plans import grasp_pose, refuse_impossible
from rig.experiments.seeds import derived_seed
from rig.lift.latency import LatencyProbe
from rig.lift.marker_distance import ExpectedDistance
from rig.lift.marker_truth import MarkerTruth
from rig.lift.measurement import LiftMeasurement
from rig.lift.result import lift_result, stage_times
from rig.lift.slip_watch import SlipSettings, SlipWatch
from rig.live.feed import NOBODY, LiveFeed
from rig.live.observer import LiveObserver
from rig.sessions.about import SIMULATED_EPOCH_NS, RecordingAbout
from rig.sessions.layout import recording_file
from rig.sessions.manifest import DISTRIBUTION, SCHEMA_VERSION
from rig.sessions.recorder import LiftRecorder
from rig.sessions.records import FailedLift, FinishedLift, LiftHead, LiftOutcome, LiftRow
from rig.sessions.timing import LatencyTimes, LiftTiming
from rig.sessions.unfinished import completed, new_recording
from rig.tactile.estimators import EstimatorChoice

LEAST_LIFT = 0.4
"""A lift rises to a random share of the object file's height, from this share to all of it."""
MAX_TRIAL_TURN_DEG = 15.0
TOLD_OF_A_LIFT = (
    "object", "name", "lift", "number", "attempt", "position", "grip_counts", "lift_height_m", "seed",
)  # fmt: skip
"""Of its head, in its recording's metadata."""


@dataclass(frozen=True, slots=True)
class LiftTask:
    """One lift to do: its number in the session, its object, its number for that object (from 1).

    grip_counts: beyond first contact; drawn where None.
    """

    number: int
    object_id: str
    lift: int
    attempt: int = 0
    grip_counts: int | None = None

    @property
    def name(self) -> str:
        """Name in logs and fault scripts, e.g. "t1/3"."""
        return f"{self.object_id}/{self.lift}"

    @property
    def recording(self) -> str:
        """File of this attempt inside the session."""
        return recording_file(self.number, self.attempt)


def all_tasks(objects: Sequence[str], lifts: int) -> list[LiftTask]:
    """Return every lift of a trial, object by object."""
    each = ((object_id, lift) for object_id in objects for lift in range(1, lifts + 1))
    return [LiftTask(number, *which) for number, which in enumerate(each, start=1)]


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """What all lifts of a trial share."""

    bench: BenchConfig
    seed: int
    estimator: EstimatorChoice
    realtime: bool = False
    react: ReactionKind = ReactionKind.NONE
    slip: SlipSettings = field(default_factory=SlipSettings)


def plan_lift(settings: TrialSettings, task: LiftTask, base_T_table: Pose) -> LiftPlan:  # noqa: N803
    """Draw position, turn, grip and height of a lift from its seed and its object's file.

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
    low, high = grasps.grip_counts
    turn = float(rng.uniform(-MAX_TRIAL_TURN_DEG, MAX_TRIAL_TURN_DEG))
    drawn = int(rng.integers(low, high + 1))
    refuse_impossible(settings.bench, grasps, place)
    return LiftPlan(
        object_id=grasps.id,
        object_name=grasps.name,
        position=place.name,
        base_T_grasp=grasp_pose(base_T_table, place, turn),
        width_m=place.width_m,
        grip_counts=drawn if task.grip_counts is None else task.grip_counts,
        lift_height_m=place.lift_height_m * float(rng.uniform(LEAST_LIFT, 1.0)),
    )


def attempt_lift(
    settings: TrialSettings,
    task: LiftTask,
    benches: BenchSource | None = None,
    live: LiveFeed = NOBODY,
    folder: Path | None = None,
) -> Attempt[LiftRow]:
    """Carry out one lift and evaluate it.

    A device's failure becomes an outcome "fault" with the error's text; nothing else is caught.
    benches: where its bench comes from; a simulated bench of its own when None. live: who looks on.
    folder: the session in which the lift is recorded, under an unfinished name; not recorded when None.
    Raises `RecordingError` if the recording cannot be written; the lift then ends as after any error.
    """
    compute_in_one_thread()
    began = time.perf_counter()
    benches = benches or FreshBenches(settings.bench, settings.realtime)
    seed = derived_seed(settings.seed, task.object_id, task.lift, attempt=task.attempt)
    plan = plan_lift(settings, task, Pose(settings.bench.table.position_m))
    head = _head(task, plan, seed, settings)
    file = None if folder is None else new_recording(folder, task.recording)
    recorder = None if file is None else LiftRecorder(file, _about(settings, head))
    measurement = new_measurement(settings, recorder)
    reaction = _reaction(settings, task, measurement)
    shown = LiveObserver(measurement, live, head) if live.listeners else None
    with completed(recorder, file) if recorder and file else nullcontext():
        with closing(shown) if shown else nullcontext():
            course = _carry_out(benches, task, seed, plan, shown or measurement, reaction)
        fault = None if course.error is None else fault_text(course.error)
        row = _row(head, measurement, fault, course)
        if row.outcome in (LiftOutcome.FALLEN, LiftOutcome.FAULT):
            benches.displaced()
    timing = LiftTiming(
        number=task.number,
        attempt=task.attempt,
        wall_s=time.perf_counter() - began,
        stages=stage_times(measurement),
        capture_to_angle=course.latency or None,
    )
    return Attempt(row, timing, fault, {task.recording: file.path} if file else {}, _warning(row))


def _about(settings: TrialSettings, head: LiftHead) -> RecordingAbout:
    """What the lift's recording says of itself; a simulated one nothing that differs between equal seeds."""
    bench = settings.bench
    values = {key: str(getattr(head, key)) for key in TOLD_OF_A_LIFT} | {
        "bench": bench.name,
        "simulated": "SIMULATED" if bench.simulated else "no",
        "session_seed": str(settings.seed),
        "estimator": settings.estimator.name,
        "window": str(settings.estimator.window),
        "tool_version": version(DISTRIBUTION),
        "schema_version": str(SCHEMA_VERSION),
        "signs": ", ".join(f"{t.serial} on finger {t.finger} {t.sign:+d}" for t in bench.tactile),
        "angles": "degrees, counter-clockwise as the external camera sees them, from the end of phase A",
    }
    return RecordingAbout(
        values,
        SIMULATED_EPOCH_NS if bench.simulated else time.time_ns() - SystemClock().now_ns(),
        bench.camera.serial,
        bench.camera_model(),
        {bench.camera.serial: bench.base_T_camera(), "table": Pose(bench.table.position_m)},
    )


def _row(head: LiftHead, measurement: LiftMeasurement, fault: str | None, course: "_Course") -> LiftRow:
    """Evaluate a lift that reached its end, angles into its recording; else say what ended it."""
    seen = {"bench_s": round(course.bench_s, 6), "speed_fraction": course.speed_fraction}
    if fault is not None:
        return FailedLift(**vars(head), accepted=False, outcome=LiftOutcome.FAULT, fault=fault, **seen)
    figures, series = lift_result(measurement)
    measurement.record_results(series)
    return FinishedLift(**vars(head), **vars(figures), accepted=True, **seen)


def _reaction(settings: TrialSettings, task: LiftTask, measurement: LiftMeasurement) -> Reaction | None:
    if settings.react is ReactionKind.NONE:
        return None
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    largest = grasps.require_largest_grip() if settings.react is ReactionKind.TIGHTEN else 0
    return Reaction(settings.react, measurement, largest)


def _warning(row: LiftRow) -> str | None:
    if not isinstance(row, FinishedLift):
        return None
    return "; ".join(str(what) for what in (row.marker_distance, row.estimator_faults) if what) or None


def new_measurement(settings: TrialSettings, recorder: LiftRecorder | None = None) -> LiftMeasurement:
    """Make the observer of one lift, the same for a lift as it happens and for its replay."""
    camera = settings.bench.camera
    truth = MarkerTruth(
        camera.marker_ids,
        camera.marker_dictionary,
        settings.bench.base_T_camera(),
        settings.bench.camera_model(),
        search_everywhere=not settings.estimator.skip,
        camera_turn_sigma_rad=settings.bench.camera_turn_sigma_rad(),
    )
    signs = {tactile.serial: tactile.sign for tactile in settings.bench.tactile}
    shifts = settings.bench.calibrations.time_shift_s
    distance = ExpectedDistance(camera.marker_side_m, settings.bench.object_distance_m())
    aspects = settings.bench.pixel_aspects()
    watch = None if settings.react is ReactionKind.NONE else SlipWatch(settings.slip)
    return LiftMeasurement(signs, settings.estimator, truth, recorder, aspects, shifts, distance, watch)


@dataclass(frozen=True, slots=True)
class _Course:
    """How a lift went: its fault, if any, how long it took by the bench's clock, how late angles came.

    A simulated clock stands still while angles are worked out, so there nothing is late.
    """

    error: DeviceError | CalibrationError | None
    bench_s: float
    latency: dict[str, LatencyTimes]
    speed_fraction: float | None


def _carry_out(
    benches: BenchSource,
    task: LiftTask,
    seed: int,
    plan: LiftPlan,
    observer: LiftObserver,
    reaction: Reaction | None,
) -> _Course:
    clock: Clock | None = None
    timed: LatencyProbe | None = None
    began_ns = 0
    speed_fraction: float | None = None
    fault: DeviceError | CalibrationError | None = None
    try:
        with benches.for_lift(seed, task.name, task.attempt) as (bench, operator):
            clock, began_ns = bench.clock, bench.clock.now_ns()
            make_ready(bench, operator, benches.after_fault)
            speed_fraction = bench.arm.state().speed_fraction
            operator.place(plan.object_id, plan.object_name)
            timed = LatencyProbe(observer, clock) if isinstance(clock, SystemClock) else None
            run_lift(bench, plan, timed or observer, reaction)
    except (DeviceError, CalibrationError) as error:
        fault = error
    bench_s = (clock.now_ns() - began_ns) / NS_PER_S if clock else 0.0
    return _Course(fault, bench_s, timed.times() if timed else {}, speed_fraction)


def _head(task: LiftTask, plan: LiftPlan, seed: int, settings: TrialSettings) -> LiftHead:
    return LiftHead(
        number=task.number,
        attempt=task.attempt,
        object=task.object_id,
        name=plan.object_name,
        lift=task.lift,
        position=plan.position,
        grip_counts=plan.grip_counts,
        lift_height_m=plan.lift_height_m,
        seed=seed,
        simulated=settings.bench.simulated,
        recording=task.recording,
        react=settings.react,
    )
