"""The slip trial: five accepted lifts for each object, each stored as soon as it ends."""

import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from drivers.errors import InputError
from drivers.types import Pose
from protocols.grasps import TRIAL_OBJECTS, GraspFile, find_grasp_file
from protocols.slip_trial import LIFT_S
from protocols.steps import TRAVEL_SPEED_M_S, home_plan, way_to
from rig.bench.assembly import home_pose
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import BenchSource
from rig.bench.twins import plain_notes
from rig.experiments.attempts import Attempt, Progress, Run, run_session
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import (
    LiftTask,
    TrialSettings,
    all_tasks,
    describe_reaction,
    plan_lift,
    require_reaction,
)
from rig.live.feed import Listener
from rig.results.summary import TrialSummary, summarize_trial
from rig.results.table import lifts_csv
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.manifest import TrialManifest, begun_on
from rig.sessions.records import LIFTS, Lift
from rig.sessions.session import Session

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
        markers_only=settings.markers_only,
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
    table, home = Pose(settings.bench.require("table").position_m), home_pose(settings.bench)
    step_m, own = settings.bench.gripper_spec().resolution_m, settings.bench.objects
    head = [
        *plain_notes(settings.bench, [find_grasp_file(i, own) for i in objects]),
        home_plan(home, "Before each lift"),
        *describe_reaction(settings, objects),
        f"The arm will move at up to {TRAVEL_SPEED_M_S} m/s between these grasps (base frame). Grip: how "
        f"far the fingers close past first contact. Lift: its height, in {LIFT_S} s.",
    ]
    motions = []
    for task in all_tasks(objects, lifts):
        plan = plan_lift(settings, task, table)
        what = (
            f"{task.name:>6} {plan.object_name}, grip {1e3 * plan.grip_steps * step_m:.1f} mm, "
            f"lift {1e3 * plan.lift_height_m:.0f} mm"
        )
        rise = plan.base_T_grasp.translated(z_m=plan.lift_height_m)
        way = (*way_to(home, plan.base_T_grasp), rise)
        motions.append(PlannedMotion(what, plan.base_T_grasp, way, TRAVEL_SPEED_M_S))
    return make_plan(settings.bench, head, motions)


def run_trial(
    folder: Path,
    settings: TrialSettings,
    objects: list[str],
    lifts: int,
    jobs: int = 1,
    resume: bool = False,
    benches: BenchSource | None = None,
    progress: Progress[Lift] = lambda done, total, row: None,
    live: Sequence[Listener] = (),
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

    def prepare(session: Session[Lift], left: int) -> Callable[[LiftTask], Attempt[Lift]]:
        _log.info("trial of %d objects x %d lifts, %d to do", len(objects), lifts, left)
        return partial(attempt_lift, settings, benches=benches, live=live, folder=folder.absolute())

    run = Run(
        session="trial",
        piece="lift",
        manifest=trial_manifest(settings, objects, lifts, remarks),
        codec=LIFTS,
        tasks=all_tasks(objects, lifts),
        prepare=prepare,
        table=("lifts.csv", lifts_csv),
        logged=lambda row: f"lift {row.object}/{row.lift}: {row.outcome}",
    )
    return summarize_trial(run_session(folder, run, resume, benches, progress, jobs))
