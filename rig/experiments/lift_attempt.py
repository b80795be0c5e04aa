"""Execute one attempt at a lift, from its plan to its row. Runs in a worker process."""

import time
from collections.abc import Iterable
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import CalibrationError, DeviceError
from drivers.realtime import compute_in_one_thread
from drivers.types import Pose
from protocols.grasps import find_grasp_file
from protocols.reaction import Reaction, ReactionKind
from protocols.readiness import make_ready
from protocols.slip_trial import LiftPlan, run_lift
from rig.bench.source import BenchSource, FreshBenches
from rig.experiments.attempts import Attempt, fault_text
from rig.experiments.grasp_plans import derived_seed
from rig.experiments.lift_plan import LiftTask, TrialSettings, lift_head, new_measurement, plan_lift
from rig.lift.measurement import LiftMeasurement
from rig.lift.recording import LatencyProbe, LiftObservers, OutlineObserver, StampRates, lift_angles
from rig.lift.result import lift_result, stage_times
from rig.live.feed import NOBODY, LiveFeed
from rig.live.observer import LiveObserver
from rig.sessions.about import SIMULATED_EPOCH_NS, RecordingAbout
from rig.sessions.manifest import SCHEMA_VERSION
from rig.sessions.recorder import LiftRecorder, RecordedAngle
from rig.sessions.records import FailedLift, FinishedLift, LiftHead, LiftOutcome, LiftRow
from rig.sessions.timing import LatencyTimes, LiftTiming
from rig.sessions.unfinished import completed, new_recording
from rig.version import VERSION

HEAD_IN_METADATA = (
    "object", "name", "lift", "number", "attempt", "position", "grip_counts", "lift_height_m", "seed",
)  # fmt: skip
"""Fields of a lift's head that its recording's metadata repeat."""


def attempt_lift(
    settings: TrialSettings,
    task: LiftTask,
    benches: BenchSource | None = None,
    live: LiveFeed = NOBODY,
    folder: Path | None = None,
) -> Attempt[LiftRow]:
    """Execute one lift and evaluate it.

    A device failure becomes the outcome "fault" with the error's text; no other error is caught. benches:
    source of the bench; None for a new simulated bench. live: viewers. folder: the session in which the lift
    is recorded, under an unfinished name; None for no recording. Raises `RecordingError` if the recording
    cannot be written; the lift then ends as after any error.
    """
    compute_in_one_thread()
    began = time.perf_counter()
    benches = benches or FreshBenches(settings.bench, settings.realtime)
    seed = derived_seed(settings.seed, task.object_id, task.lift, attempt=task.attempt)
    plan = plan_lift(settings, task, Pose(settings.bench.table.position_m))
    head = lift_head(task, plan, seed, settings)
    file = None if folder is None else new_recording(folder, task.recording)
    recorder = None if file is None else LiftRecorder(file, _about(settings, head))
    measurement = new_measurement(settings)
    reaction = _reaction(settings, task, measurement)
    shown = LiveObserver(measurement, live, head) if live.listeners else None
    outlines = None if recorder is None else OutlineObserver(measurement, recorder)
    observers = [each for each in (recorder, measurement, outlines, shown) if each is not None]
    with completed(recorder, file) if recorder and file else nullcontext():
        with closing(shown) if shown else nullcontext():
            course = _carry_out(benches, task, seed, plan, LiftObservers(measurement, observers), reaction)
        fault = None if course.error is None else fault_text(course.error)
        row, angles = _row(head, measurement, fault, course)
        if recorder is not None:
            for topic, angle in angles:
                recorder.angle(topic, angle)
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
    """Return the metadata of a lift's recording; those of a simulated lift depend only on its seed."""
    bench = settings.bench
    values = {key: str(getattr(head, key)) for key in HEAD_IN_METADATA} | {
        "bench": bench.name,
        "simulated": "SIMULATED" if bench.simulated else "no",
        "session_seed": str(settings.seed),
        "estimator": settings.estimator.name,
        "window": str(settings.estimator.window),
        "tool_version": VERSION,
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


def _row(
    head: LiftHead, measurement: LiftMeasurement, fault: str | None, course: "_Course"
) -> tuple[LiftRow, Iterable[tuple[str, RecordedAngle]]]:
    """Return the row of a lift and its angles; for a lift that ended in a fault, the fault and no angles."""
    seen = {"bench_s": round(course.bench_s, 6), "speed_fraction": course.speed_fraction}
    if fault is not None:
        return FailedLift(**vars(head), accepted=False, outcome=LiftOutcome.FAULT, fault=fault, **seen), ()
    figures, series = lift_result(measurement)
    row = FinishedLift(
        **vars(head), **vars(figures), accepted=True, clock_rates=course.clock_rates or None, **seen
    )
    return row, lift_angles(measurement, series)


def _reaction(settings: TrialSettings, task: LiftTask, measurement: LiftMeasurement) -> Reaction | None:
    if settings.react is ReactionKind.NONE:
        return None
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    if settings.react is not ReactionKind.TIGHTEN:
        return Reaction(settings.react, measurement)
    largest = settings.bench.gripper_spec().steps_for(grasps.require_largest_grip())
    return Reaction(settings.react, measurement, largest)


def _warning(row: LiftRow) -> str | None:
    if not isinstance(row, FinishedLift):
        return None
    return "; ".join(row.warnings) or None


@dataclass(frozen=True, slots=True)
class _Course:
    """Course of a lift: its fault, if any, its duration by the bench's clock, and the latency of its angles.

    A simulated clock does not advance while angles are computed, so there is no latency. clock_rates: see
    `FinishedLift`.
    """

    error: DeviceError | CalibrationError | None
    bench_s: float
    latency: dict[str, LatencyTimes]
    speed_fraction: float | None
    clock_rates: dict[str, float]


def _carry_out(
    benches: BenchSource,
    task: LiftTask,
    seed: int,
    plan: LiftPlan,
    observers: LiftObservers,
    reaction: Reaction | None,
) -> _Course:
    clock: Clock | None = None
    timed: LatencyProbe | None = None
    stamps: StampRates | None = None
    began_ns = 0
    speed_fraction: float | None = None
    fault: DeviceError | CalibrationError | None = None
    try:
        with benches.for_lift(seed, task.name, task.attempt) as (bench, operator):
            clock, began_ns = bench.clock, bench.clock.now_ns()
            make_ready(bench, operator, benches.after_fault)
            speed_fraction = bench.arm.state().speed_fraction
            operator.place(plan.object_id, plan.object_name)
            stamps = StampRates(clock)
            observers = observers.followed_by(stamps)
            if isinstance(clock, SystemClock):
                timed = LatencyProbe(clock)
                observers = observers.followed_by(timed)
            run_lift(bench, plan, observers, reaction)
    except (DeviceError, CalibrationError) as error:
        fault = error
    bench_s = (clock.now_ns() - began_ns) / NS_PER_S if clock else 0.0
    latency, clock_rates = timed.times() if timed else {}, stamps.amiss() if stamps else {}
    return _Course(fault, bench_s, latency, speed_fraction, clock_rates)
