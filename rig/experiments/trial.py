"""The slip trial: five accepted lifts for each object, each stored as soon as it ends."""

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drivers.errors import InputError
from drivers.types import Pose
from protocols.grasps import TRIAL_OBJECTS, GraspFile, find_grasp_file
from protocols.home import home_plan
from protocols.slip_trial import LIFT_S, LiftPlan
from protocols.steps import TRAVEL_SPEED_M_S, way_to
from rig.bench.assembly import home_pose
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import BenchSource
from rig.bench.twins import plain_notes
from rig.experiments.attempts import Progress, Wording, left_to_do, repeat_until_accepted
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import (
    LiftTask,
    TrialSettings,
    all_tasks,
    describe_reaction,
    plan_lift,
    require_reaction,
)
from rig.live.feed import NOBODY, LiveFeed
from rig.results.summary import TrialSummary, summarize_trial
from rig.results.table import lifts_csv
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.manifest import TrialManifest, begun_on
from rig.sessions.records import LIFTS, Lift
from rig.sessions.session import open_session

WORDING = Wording("trial", "lift")
LIFTS_CSV = "lifts.csv"
_log = logging.getLogger("rig.experiments.trial")


def trial_manifest(
    settings: TrialSettings, objects: list[str], lifts: int, remarks: Remarks = NO_REMARKS
) -> TrialManifest:
    """Return a new trial's manifest: the request, which must be the same to continue it."""
    return TrialManifest(
        **vars(begun_on(settings.bench, "trial", settings.seed, objects, remarks)),
        lifts_per_object=lifts,
        estimator=settings.estimator.name,
        window=settings.estimator.window,
        skip=settings.estimator.skip,
        truth="edges",
        react=settings.react,
        false_alarms_per_hour=settings.slip.false_alarms_per_hour,
        max_turn_deg=settings.slip.max_turn_deg,
    )


def resolve_objects(names: list[str] | None, own: Sequence[GraspFile] = ()) -> list[str]:
    """Return object ids from ids or names, by default the paper's nine. own: a lab's objects.

    Raises `InputError` for an unknown object, or for one named twice.
    """
    ids = [find_grasp_file(name, own).id for name in names or TRIAL_OBJECTS]
    twice = next((i for i in ids if ids.count(i) > 1), None)
    if twice:
        raise InputError(f"object {twice} is named twice: use --lifts for more lifts of one object")
    return ids


def trial_plan(settings: TrialSettings, objects: list[str], lifts: int) -> Plan:
    """Return what a trial will do with the arm and the gripper, lift by lift.

    Raises `InputError` for an object that cannot be lifted here.
    """
    table = Pose(settings.bench.table.position_m)
    home = home_pose(settings.bench)
    own = settings.bench.objects
    head = [
        *plain_notes(settings.bench, [find_grasp_file(i, own) for i in objects]),
        home_plan(home, "Before each lift"),
        *describe_reaction(settings, objects),
        f"The arm will move at up to {TRAVEL_SPEED_M_S} m/s between these grasps (base frame):",
    ]
    step_m = settings.bench.gripper_spec().resolution_m
    motions = [
        _lift_motion(task, plan_lift(settings, task, table), home, step_m)
        for task in all_tasks(objects, lifts)
    ]
    return make_plan(settings.bench, head, motions)


def _lift_motion(task: LiftTask, plan: LiftPlan, home: Pose, step_m: float) -> PlannedMotion:
    """Return the planned motion of a lift. step_m: resolution of the gripper."""
    what = (
        f"{task.name:>6} {plan.object_name}, {1e3 * plan.grip_steps * step_m:.1f} mm past contact, lifted "
        f"{plan.lift_height_m:.3f} m in {LIFT_S} s"
    )
    rise = plan.base_T_grasp.translated(z_m=plan.lift_height_m)
    return PlannedMotion(what, plan.base_T_grasp, (*way_to(home, plan.base_T_grasp), rise), TRAVEL_SPEED_M_S)


def run_trial(
    folder: Path,
    settings: TrialSettings,
    objects: list[str],
    lifts: int,
    jobs: int = 1,
    resume: bool = False,
    benches: BenchSource | None = None,
    progress: Progress[Lift] = lambda done, total, row: None,
    live: LiveFeed = NOBODY,
    remarks: Remarks = NO_REMARKS,
) -> TrialSummary:
    """Run a trial, or the unfinished part of it, and return its summary.

    benches: source of the bench for each lift (`session_bench`); None for simulated ones in this process.
    progress: called after each attempt with the number of accepted lifts, the number of all lifts, and the
    row. live: viewers. remarks: stored with the session. Raises `InputError` or `RecordingError`, see
    `require_reaction` and `open_session`; `DeviceError` after three rig faults in a row. Finished lifts stay
    on disk, and `resume` continues from them.
    """
    require_reaction(settings, objects)
    with open_session(folder, trial_manifest(settings, objects, lifts, remarks), LIFTS, resume) as session:
        was_complete = session.complete
        if not was_complete:
            if benches is not None:
                benches.begin()
            session.keep()
            tasks = left_to_do(all_tasks(objects, lifts), session.rows, lambda row: row.number)
            _log.info("trial of %d objects x %d lifts, %d to do", len(objects), lifts, len(tasks))
            work = partial(attempt_lift, settings, benches=benches, live=live, folder=folder.absolute())
            repeat_until_accepted(session, tasks, work, WORDING, progress, jobs)
            session.finish(order=lambda row: (row.number, row.attempt))
            for row in session.rows:
                _log.info("lift %s/%s: %s", row.object, row.lift, row.outcome)
        summary = summarize_trial(session.rows)
        if not was_complete or not (session.folder / LIFTS_CSV).exists():
            session.write(LIFTS_CSV, lifts_csv(session.rows))
        return summary
