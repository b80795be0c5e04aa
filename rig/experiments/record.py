"""Record grasp poses of one object: a session with images in the layout of the public data set.

The layout is that of the paper's data set (VISTASE): a folder per object with `image_label`, in which LabelMe
stores its polygons beside the images.
"""

import csv
import io
import logging
from dataclasses import asdict
from functools import partial
from pathlib import Path

from drivers.errors import InputError, SessionError
from drivers.images import encode_png, load_image
from drivers.types import Image
from protocols.grasps import grasp_poses
from protocols.home import home_plan
from protocols.readiness import free_hand
from protocols.record_grasps import record_reference, record_untouched
from protocols.steps import TRAVEL_SPEED_M_S, way_to
from rig.bench.assembly import home_pose
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import BenchSource, FreshBenches
from rig.bench.twins import plain_notes
from rig.experiments.attempts import Progress, Wording, left_to_do, repeat_until_accepted
from rig.experiments.grasp_plans import derived_seed
from rig.experiments.pose_attempt import PoseTask, RecordSettings, arm_pose, attempt_pose, hand_pose
from rig.experiments.pose_capture import ReferenceCapture
from rig.live.feed import NOBODY, LiveFeed
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.files import reference_file
from rig.sessions.manifest import RecordManifest, begun_on
from rig.sessions.records import POSES, PoseRow
from rig.sessions.session import Session, open_session
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder
from rig.terminal.screen import begin_phase

MANIFEST_COLUMNS: tuple[str, ...] = (
    "file",
    "pose",
    "position",
    "orientation_deg",
    "grip_counts",
    "serial",
    "time_s",
    "contact_area_px",
)
WORDING = Wording("recording", "pose")
_log = logging.getLogger("rig.experiments.record")


def record_manifest(settings: RecordSettings, remarks: Remarks = NO_REMARKS) -> RecordManifest:
    """Return a new recording's manifest: the request, which must be the same to continue it."""
    return RecordManifest(
        **vars(begun_on(settings.bench, "record", settings.seed, [settings.grasps.id], remarks)),
        poses=settings.poses,
        images=settings.images,
        randomised=settings.randomise,
        by=settings.by,
    )


def recording_plan(settings: RecordSettings) -> Plan:
    """Return where a recording will move the arm and how firmly the fingers will close, pose by pose.

    Raises `InputError` for an object that cannot be grasped here.
    """
    if settings.by == "hand":
        return _hand_plan(settings)
    home = home_pose(settings.bench)
    head = [
        *plain_notes(settings.bench, [settings.grasps]),
        home_plan(home, "Before each pose"),
        f"The arm will move at up to {TRAVEL_SPEED_M_S} m/s to these grasps (base frame):",
    ]
    motions = []
    for task in _all_tasks(settings):
        plan = arm_pose(settings, task)
        what = (
            f"{task.number:>2} {task.pose.position.name} at {task.pose.orientation_deg:+.0f} deg, "
            f"up to {plan.grips[-1][0]} steps past contact"
        )
        way = way_to(home, plan.base_T_grasp)
        motions.append(PlannedMotion(what, plan.base_T_grasp, way, TRAVEL_SPEED_M_S))
    return make_plan(settings.bench, head, motions)


def _hand_plan(settings: RecordSettings) -> Plan:
    """Return the requests to the person in a recording by hand."""
    poses = [hand_pose(settings, task) for task in _all_tasks(settings)]
    tips = [tip.serial for tip in settings.bench.tactile]
    return make_plan(
        settings.bench,
        [
            *plain_notes(settings.bench, [settings.grasps]),
            f"Nothing moves. You press object {settings.grasps.id} ({settings.grasps.name}) by hand onto "
            f"{' and then '.join(tips)}, in each of these poses, and confirm when it is pressed:",
            *(f"  {n:>2} {p.position} at {p.orientation_deg:+.0f} deg" for n, p in enumerate(poses, 1)),
        ],
        [],
    )


def run_record(
    folder: Path,
    settings: RecordSettings,
    resume: bool = False,
    benches: BenchSource | None = None,
    progress: Progress[PoseRow] = lambda done, total, row: None,
    remarks: Remarks = NO_REMARKS,
    live: LiveFeed = NOBODY,
) -> list[PoseRow]:
    """Record the unfinished poses; return the rows of all attempts.

    benches: source of the bench for each pose (`session_bench`); None for simulated ones. remarks: stored
    with the session. live: viewers. Raises `InputError` for impossible numbers, `DeviceError` after three
    faults in a row; finished poses stay on disk, and `resume` continues from them.
    """
    tasks = _all_tasks(settings)
    with open_session(folder, record_manifest(settings, remarks), POSES, resume) as session:
        if not session.complete:
            benches = benches or FreshBenches(settings.bench, variation_seed=settings.variation_seed)
            benches.begin()
            session.keep()
            finders = _references(session, settings, benches)
            left = left_to_do(tasks, session.rows, lambda row: row.pose)
            work = partial(attempt_pose, settings, finders, benches, live=live)
            repeat_until_accepted(session, left, work, WORDING, progress)
            session.finish(order=lambda row: (row.pose, row.attempt))
            for row in session.rows:
                _log.info("pose %s: %d images", row.pose, len(row.images))
        session.write("images.csv", _manifest_csv(session.rows).encode())
        return session.rows


def _all_tasks(settings: RecordSettings) -> list[PoseTask]:
    """Return all poses with their share of the images. Raises `InputError` for impossible numbers."""
    poses = grasp_poses(settings.grasps)
    if settings.poses > len(poses):
        raise InputError(
            f"object {settings.grasps.id} has {len(poses)} poses in its file, not {settings.poses}"
        )
    least = len(settings.bench.tactile)
    if settings.images < least * settings.poses:
        raise InputError(
            f"--images {settings.images} is too few: at least {('one', 'two')[least - 1]} per pose "
            "(one per fingertip)"
        )
    share, rest = divmod(settings.images, settings.poses)
    return [
        PoseTask(settings.grasps.id, pose, share + (i < rest))
        for i, pose in enumerate(poses[: settings.poses])
    ]


def _references(
    session: Session[PoseRow], settings: RecordSettings, benches: BenchSource
) -> dict[str, ContactFinder]:
    """Record the no-contact reference once; a continued session uses its stored one."""
    serials = [tactile.serial for tactile in settings.bench.tactile]
    names = {serial: reference_file(serial) for serial in serials}
    if not all((session.folder / name).exists() for name in names.values()):
        observer = ReferenceCapture({serial: [] for serial in serials})
        seed = derived_seed(settings.seed, settings.grasps.id, "reference")
        begin_phase("recording the untouched gel")
        with benches.for_lift(seed, "reference") as (bench, operator):
            if settings.by == "hand":
                record_untouched(bench, operator, observer)
            else:
                free_hand(bench, operator)
                record_reference(bench, observer)
        for serial, name in names.items():
            session.write(name, encode_png(mean_background(observer.frames[serial])))
    return {serial: ContactFinder(_read_png(session.folder / name)) for serial, name in names.items()}


def _manifest_csv(rows: list[PoseRow]) -> str:
    """Return the table of images as CSV: pose, grip, sensor and time of each."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(MANIFEST_COLUMNS), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        pose = {key: getattr(row, key) for key in ("pose", "position", "orientation_deg")}
        writer.writerows({**pose, **asdict(image)} for image in row.images)
    return text.getvalue()


def _read_png(path: Path) -> Image:
    image = load_image(path)
    if image is None:
        raise SessionError(f"{path}: the reference image cannot be read; record into a new --out")
    return image
