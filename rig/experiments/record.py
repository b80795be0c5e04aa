"""Recording grasp poses of one object: a session with images in the data set's layout.

The layout is the paper's public data set (VISTASE): a folder per object with `image_label`,
where LabelMe keeps its polygons beside the images.
"""

import csv
import io
import logging
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from drivers.bench import Bench
from drivers.errors import DeviceError, InputError, SessionError
from drivers.images import encode_png, load_image
from drivers.types import Image, Pose
from protocols.grasps import GraspFile, GraspPose, grasp_poses
from protocols.home import home_plan
from protocols.operator import Operator
from protocols.readiness import free_hand, make_ready
from protocols.record_grasps import PosePlan, record_pose, record_reference
from protocols.steps import TRAVEL_SPEED_M_S
from rig.bench.assembly import home_pose, true_masks
from rig.bench.source import BenchSource, FreshBenches
from rig.config import BenchConfig
from rig.experiments.lift_attempt import MAX_FAULTS_IN_A_ROW, fault_text, grasp_pose, refuse_too_wide
from rig.experiments.pose_capture import PoseCapture, ReferenceCapture
from rig.experiments.seeds import derived_seed
from rig.sessions.layout import TRUE_MASKS
from rig.sessions.manifest import RecordManifest, begun_on
from rig.sessions.records import POSES, PoseImage, PoseRow
from rig.sessions.session import Session, open_session
from rig.sessions.timing import PoseTiming
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder

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
GRIPS_PER_POSE = 5
_log = logging.getLogger("rig.experiments.record")


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """What a recording is asked for: `images` counts both fingertips, over all poses.

    randomise: simulated sensors unlike those of a bench, drawn from the seed.
    """

    bench: BenchConfig
    seed: int
    grasps: GraspFile
    poses: int
    images: int
    randomise: bool = False

    @property
    def variation_seed(self) -> int | None:
        """What the sensors are drawn from, None for the bench's own."""
        return derived_seed(self.seed, "sensors") if self.randomise else None


def record_manifest(settings: RecordSettings) -> RecordManifest:
    """Return a new recording's manifest: what is asked for, and must be the same to continue it."""
    return RecordManifest(
        **vars(begun_on(settings.bench, "record", settings.seed, [settings.grasps.id])),
        poses=settings.poses,
        images=settings.images,
        randomised=settings.randomise,
    )


def describe_recording(settings: RecordSettings) -> str:
    """Say where a recording will move the arm and how firmly the fingers will close, pose by pose."""
    table = Pose(settings.bench.table.position_m)
    lines = [
        home_plan(home_pose(settings.bench), "Before each pose"),
        f"The arm will move at up to {TRAVEL_SPEED_M_S} m/s to these grasps (base frame):",
    ]
    for pose, images in zip(grasp_poses(settings.grasps), _quotas(settings), strict=False):
        plan = plan_pose(settings, pose, images, table)
        x, y, z = plan.base_T_grasp.position_m
        lines.append(
            f"  {pose.number:>2} {pose.position.name} at {pose.orientation_deg:+.0f} deg: "
            f"({x:.3f}, {y:.3f}, {z:.3f}) m, up to {plan.grips[-1][0]} counts past contact"
        )
    return "\n".join([*lines, "Begin?"])


def run_record(
    folder: Path,
    settings: RecordSettings,
    resume: bool = False,
    benches: BenchSource | None = None,
    progress: Callable[[int, int, PoseRow], None] = lambda done, total, row: None,
) -> list[PoseRow]:
    """Record the poses that are still to do; return the rows of all attempts.

    benches: where poses get their bench (`session_bench`); simulated ones when None.
    Raises `InputError` for impossible numbers, `DeviceError` after three faults in a row;
    finished poses stay on disk and `resume` goes on from them.
    """
    quotas = _quotas(settings)
    with open_session(folder, record_manifest(settings), POSES, resume) as session:
        if not session.complete:
            benches = benches or FreshBenches(settings.bench, variation_seed=settings.variation_seed)
            finders = _references(session, settings, benches)
            _record_poses(session, settings, finders, quotas, benches, progress)
            session.finish(order=lambda row: (row.pose, row.attempt))
            for row in session.rows:
                _log.info("pose %s: %d images", row.pose, len(row.images))
        session.write("images.csv", _manifest_csv(session.rows).encode())
        return session.rows


def plan_pose(settings: RecordSettings, pose: GraspPose, images: int, base_T_table: Pose) -> PosePlan:  # noqa: N803
    """Plan one pose: its images spread over grips from the lightest to the firmest."""
    refuse_too_wide(settings.bench, settings.grasps, pose.position)
    low, high = settings.grasps.grip_counts
    levels = np.linspace(low - 1, high, min(GRIPS_PER_POSE, images)).round().astype(int)
    share = [images // len(levels) + (i < images % len(levels)) for i in range(len(levels))]
    return PosePlan(
        object_id=settings.grasps.id,
        object_name=settings.grasps.name,
        pose_number=pose.number,
        base_T_grasp=grasp_pose(base_T_table, pose.position.offset_m, pose.orientation_deg),
        width_m=pose.position.width_m,
        grips=tuple((int(level), count) for level, count in zip(levels, share, strict=True)),
    )


def object_folder(grasps: GraspFile) -> str:
    """Return the object's folder in the data set's layout, e.g. "07_spam"."""
    number = f"{int(grasps.id):02d}" if grasps.id.isdigit() else grasps.id
    return f"{number}_{grasps.name.replace(' ', '_')}"


def _quotas(settings: RecordSettings) -> list[int]:
    available = len(grasp_poses(settings.grasps))
    if settings.poses > available:
        raise InputError(
            f"object {settings.grasps.id} has {available} poses in its file, not {settings.poses}"
        )
    if settings.images < 2 * settings.poses:
        raise InputError(f"--images {settings.images} is too few: at least two per pose (one per fingertip)")
    share, rest = divmod(settings.images, settings.poses)
    return [share + (i < rest) for i in range(settings.poses)]


def _references(
    session: Session[PoseRow], settings: RecordSettings, benches: BenchSource
) -> dict[str, ContactFinder]:
    """Take the no-contact reference once; a continued session uses the one it has."""
    serials = [tactile.serial for tactile in settings.bench.tactile]
    names = {serial: f"reference/{serial}.png" for serial in serials}
    if not all((session.folder / name).exists() for name in names.values()):
        watch = ReferenceCapture({serial: [] for serial in serials})
        seed = derived_seed(settings.seed, settings.grasps.id, "reference")
        with benches.for_lift(seed, "reference") as (bench, operator):
            free_hand(bench, operator)
            record_reference(bench, watch)
        for serial, name in names.items():
            session.write(name, encode_png(mean_background(watch.frames[serial])))
    return {serial: ContactFinder(_read_png(session.folder / name)) for serial, name in names.items()}


def _record_poses(
    session: Session[PoseRow],
    settings: RecordSettings,
    finders: dict[str, ContactFinder],
    quotas: list[int],
    benches: BenchSource,
    progress: Callable[[int, int, PoseRow], None],
) -> None:
    done = {row.pose for row in session.rows if row.accepted}
    faults = 0
    for pose, images in zip(grasp_poses(settings.grasps), quotas, strict=False):
        while pose.number not in done:
            row = _attempt(session, settings, finders, pose, images, benches)
            if row.accepted:
                done.add(pose.number)
                faults = 0
            else:
                faults += 1
            progress(len(done), settings.poses, row)
            if faults >= MAX_FAULTS_IN_A_ROW:
                raise DeviceError(
                    f"recording: {faults} faults in a row, the last: {row.fault}; {len(done)} of "
                    f"{settings.poses} poses are done: mend the fault, then continue with --resume"
                )


def _attempt(
    session: Session[PoseRow],
    settings: RecordSettings,
    finders: dict[str, ContactFinder],
    pose: GraspPose,
    images: int,
    benches: BenchSource,
) -> PoseRow:
    """Record one pose; images first, line last. A device's failure is a row that is not accepted."""
    began = time.perf_counter()
    attempt = sum(row.pose == pose.number for row in session.rows)
    name = f"{settings.grasps.id}/{pose.number}"
    seed = derived_seed(
        settings.seed, settings.grasps.id, "pose", pose.number, *([attempt] if attempt else [])
    )
    plan = plan_pose(settings, pose, images, Pose(settings.bench.table.position_m))
    watch = PoseCapture(finders)
    fault = _carry_out(benches, benches.for_lift(seed, name, attempt), plan, watch)
    if fault:
        benches.displaced()
    row = PoseRow(
        pose=pose.number,
        attempt=attempt,
        position=pose.position.name,
        orientation_deg=pose.orientation_deg,
        accepted=fault is None,
        fault=fault,
        rejected_frames=watch.rejected,
        images=() if fault else _keep_images(session, settings.grasps, pose, watch),
        seed=seed,
        simulated=settings.bench.simulated,
        force_n=None,
    )
    session.add(row, PoseTiming(pose=pose.number, attempt=attempt, wall_s=time.perf_counter() - began))
    return row


def _carry_out(
    benches: BenchSource,
    given: AbstractContextManager[tuple[Bench, Operator]],
    plan: PosePlan,
    watch: PoseCapture,
) -> str | None:
    """Return None, or the fault's text."""
    try:
        with given as (bench, operator):
            watch.true_masks = true_masks(bench)
            make_ready(bench, operator, benches.after_fault)
            operator.place(plan.object_id, plan.object_name)
            record_pose(bench, plan, watch)
    except DeviceError as error:
        _log.warning("pose %d: %s", plan.pose_number, error)
        return fault_text(error)
    return None


def _keep_images(
    session: Session[PoseRow], grasps: GraspFile, pose: GraspPose, watch: PoseCapture
) -> tuple[PoseImage, ...]:
    files = []
    for number, (frame, grip_counts, area) in enumerate(watch.taken):
        name = f"{object_folder(grasps)}/image_label/p{pose.number:02d}_{number + 1:02d}_{frame.serial}.png"
        session.write(name, encode_png(frame.image))
        if frame.serial in watch.true_masks:
            session.write(f"{TRUE_MASKS}/{Path(name).stem}.png", encode_png(watch.masks[number]))
        files.append(
            PoseImage(
                file=name,
                grip_counts=grip_counts,
                serial=frame.serial,
                time_s=frame.time_ns / 1e9,
                contact_area_px=area,
            )
        )
    return tuple(files)


def _manifest_csv(rows: list[PoseRow]) -> str:
    """Return the manifest of images: pose, grip, sensor and time of each."""
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
