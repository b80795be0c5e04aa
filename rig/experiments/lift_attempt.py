"""Execute one attempt at a lift, from its plan to its row. Runs in a worker process."""

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from drivers.clock import SystemClock
from drivers.errors import CalibrationError, DeviceError
from drivers.realtime import compute_in_one_thread
from drivers.types import Pose
from protocols.grasps import find_grasp_file
from protocols.observer import NO_EVENTS
from protocols.reaction import Reaction, ReactionKind
from protocols.readiness import make_ready
from protocols.slip_trial import run_lift
from rig.bench.source import BenchSource, FreshBenches
from rig.experiments.attempts import Attempt, fault_text
from rig.experiments.lift_plan import LiftTask, TrialSettings, new_measurement, planned_lift
from rig.lift.recording import FrameDelays, LiftObservers, record_lift
from rig.lift.result import evaluate_lift
from rig.lift.slip_watch import SlipWatch
from rig.live.feed import Listener
from rig.live.observer import LiveObserver
from rig.sessions.about import SIMULATED_EPOCH_NS, RecordingAbout
from rig.sessions.manifest import SCHEMA_VERSION
from rig.sessions.records import Lift, LiftTiming
from rig.version import version_text

IN_METADATA = (
    "object", "name", "lift", "number", "attempt", "position", "grip_counts", "lift_height_m", "seed",
)  # fmt: skip
"""Fields of a lift that its recording's metadata repeat."""


def attempt_lift(
    settings: TrialSettings,
    task: LiftTask,
    benches: BenchSource | None = None,
    live: Sequence[Listener] = (),
    folder: Path | None = None,
) -> Attempt[Lift]:
    """Execute one lift and evaluate it.

    A device failure becomes the outcome "fault" with the error's text; no other error is caught. benches:
    source of the bench; None for a new simulated bench. live: viewers. folder: the session in which the lift
    is recorded, under an unfinished name; None for no recording. Raises `RecordingError` if the recording
    cannot be written; the lift then ends as after any error.
    """
    compute_in_one_thread()
    began = time.perf_counter()
    benches = benches or FreshBenches(settings.bench, settings.realtime)
    plan, lift = planned_lift(settings, task)
    measurement = new_measurement(settings)
    about = describe_recording(settings, lift)
    reaction = choose_reaction(settings, task, measurement.watch)
    viewers = LiveObserver(measurement, live, lift) if live else NO_EVENTS
    delays = FrameDelays()
    with record_lift(folder, task.recording, about, measurement, settings.markers_only) as recording:
        try:
            with (
                closing(viewers),
                benches.for_lift(lift.seed, task.name, task.attempt) as (bench, operator),
            ):
                delays = FrameDelays(bench.clock)
                make_ready(bench, operator, benches.after_fault)
                lift = replace(lift, speed_fraction=bench.arm.state().speed_fraction)
                operator.place(plan.object_id, plan.object_name)
                # A frame is stored as received, then measured. Outlines and viewers need the measurement, and
                # the delays include the work of all others.
                observers = recording.received, measurement, recording.outlines, viewers, delays
                run_lift(bench, plan, LiftObservers(measurement, *observers), reaction)
                delays.check_clocks()
        except (DeviceError, CalibrationError) as error:
            lift = replace(lift, fault=fault_text(error), bench_s=delays.spent_s())
        else:
            lift = evaluate_lift(measurement, replace(lift, bench_s=delays.spent_s()))
        for series in (lift.angles or {}).values():
            recording.store(series)
        if lift.displaced:
            benches.note_displaced()
    timing = LiftTiming(
        number=task.number,
        attempt=task.attempt,
        wall_s=time.perf_counter() - began,
        stages=measurement.stage_times(),
        capture_to_angle=delays.latency() or None,
    )
    files = {name: file.path for name, file in recording.files.items()}
    return Attempt(replace(lift, angles=None), timing, files, "; ".join(lift.warnings) or None)


def describe_recording(settings: TrialSettings, lift: Lift) -> RecordingAbout:
    """Return the metadata of a lift's recording; those of a simulated lift depend only on its seed."""
    bench = settings.bench
    camera = bench.require("camera").serial
    values = {key: str(getattr(lift, key)) for key in IN_METADATA} | {
        "bench": bench.name,
        "simulated": "SIMULATED" if bench.simulated else "no",
        "session_seed": str(settings.seed),
        "estimator": settings.estimator.name,
        "window": str(settings.estimator.window),
        "tool_version": version_text(),
        "schema_version": str(SCHEMA_VERSION),
        "signs": ", ".join(f"{t.serial} on finger {t.finger} {t.sign:+d}" for t in bench.tactile),
        "angles": "degrees, counter-clockwise as the external camera sees them, from the end of phase A",
    }
    return RecordingAbout(
        values,
        SIMULATED_EPOCH_NS if bench.simulated else time.time_ns() - SystemClock().now_ns(),
        camera,
        bench.camera_model(),
        {camera: bench.base_T_camera(), "table": Pose(bench.require("table").position_m)},
    )


def choose_reaction(settings: TrialSettings, task: LiftTask, watch: SlipWatch | None) -> Reaction | None:
    """Return the reaction to slip of a lift; None without one."""
    if watch is None:
        return None
    if settings.react is not ReactionKind.TIGHTEN:
        return Reaction(settings.react, watch)
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    largest = settings.bench.gripper_spec().steps_for(grasps.require_largest_grip())
    return Reaction(settings.react, watch, largest)
