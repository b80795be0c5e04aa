"""Execute one attempt at a grasp pose, from its plan to its row and images."""

import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.errors import DeviceError
from drivers.images import encode_png
from drivers.types import Pose
from protocols.grasps import GraspFile, GraspPose
from protocols.readiness import make_ready
from protocols.record_grasps import HandPose, PosePlan, record_pose, record_pose_by_hand
from rig.bench.assembly import simulated_layout, true_masks
from rig.bench.source import BenchSource
from rig.bench.twins import refuse_undrawn
from rig.config import BenchConfig
from rig.experiments.attempts import Attempt, fault_text
from rig.experiments.grasp_plans import derived_seed, grasp_pose, refuse_impossible
from rig.experiments.pose_capture import PoseCapture
from rig.live.feed import NOBODY, LiveFeed
from rig.live.observer import PictureSender
from rig.sessions.files import true_mask_file
from rig.sessions.records import PoseImage, PoseRow
from rig.sessions.timing import PoseTiming
from rig.tactile.contact.finder import ContactFinder

GRIPS_PER_POSE = 5
"""Most different grips of one pose."""


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """The request for a recording: `images` is the number over both fingertips and all poses.

    randomise: use simulated sensors that differ from the bench's own, drawn from the seed. by: whether the
    arm or a person's hand holds the object.
    """

    bench: BenchConfig
    seed: int
    grasps: GraspFile
    poses: int
    images: int
    randomise: bool = False
    by: Literal["arm", "hand"] = "arm"

    @property
    def variation_seed(self) -> int | None:
        """Seed of the sensors; None for the bench's own."""
        return derived_seed(self.seed, "sensors") if self.randomise else None


@dataclass(frozen=True, slots=True)
class PoseTask:
    """One pose to record, and the number of its images."""

    object_id: str
    pose: GraspPose
    images: int
    attempt: int = 0

    @property
    def number(self) -> int:
        """Number of the pose in the object's file, from 1."""
        return self.pose.number

    @property
    def name(self) -> str:
        """Name in logs and fault scripts, e.g. "7/3"."""
        return f"{self.object_id}/{self.number}"


def hand_pose(settings: RecordSettings, task: PoseTask) -> HandPose:
    """Plan one pose pressed by hand. Raises `InputError` if a simulated bench cannot draw the object."""
    grasps, place = settings.grasps, task.pose.position
    refuse_undrawn(settings.bench, grasps)
    table = simulated_layout(settings.bench).base_T_table
    return HandPose(
        object_id=grasps.id,
        object_name=grasps.name,
        position=place.name,
        orientation_deg=place.turn_deg + task.pose.orientation_deg,
        images=task.images,
        base_T_grasp=grasp_pose(table, place, task.pose.orientation_deg),
        opening_m=place.width_m - sum(grasps.grip_m) / 2.0,
    )


def arm_pose(settings: RecordSettings, task: PoseTask) -> PosePlan:
    """Plan one pose, with its images distributed over grips from the lightest to the firmest."""
    pose, images, base_T_table = task.pose, task.images, Pose(settings.bench.table.position_m)  # noqa: N806
    refuse_impossible(settings.bench, settings.grasps, pose.position)
    low, high = map(settings.bench.gripper_spec().steps_for, settings.grasps.grip_m)
    levels = np.linspace(low - 1, high, min(GRIPS_PER_POSE, images)).round().astype(int)
    share = [images // len(levels) + (i < images % len(levels)) for i in range(len(levels))]
    return PosePlan(
        object_id=settings.grasps.id,
        object_name=settings.grasps.name,
        pose_number=pose.number,
        base_T_grasp=grasp_pose(base_T_table, pose.position, pose.orientation_deg),
        width_m=pose.position.width_m,
        grips=tuple((int(level), count) for level, count in zip(levels, share, strict=True)),
    )


def attempt_pose(
    settings: RecordSettings,
    finders: dict[str, ContactFinder],
    benches: BenchSource,
    task: PoseTask,
    live: LiveFeed = NOBODY,
) -> Attempt[PoseRow]:
    """Record one pose. A device failure gives a row that is not accepted; no other error is caught.

    finders: of contacts, by serial. live: viewers.
    """
    began = time.perf_counter()
    seed = derived_seed(settings.seed, task.object_id, "pose", task.number, attempt=task.attempt)
    plan = hand_pose(settings, task) if settings.by == "hand" else arm_pose(settings, task)
    with closing(PictureSender(live)) as pictures:
        observer = PoseCapture(finders, shown=pictures if live.pictures else None)
        fault = _carry_out(benches, task, seed, plan, observer)
    if fault:
        benches.displaced()
    images, files = ((), {}) if fault else _images(settings.grasps, task.number, observer)
    row = PoseRow(
        pose=task.number,
        attempt=task.attempt,
        position=task.pose.position.name,
        orientation_deg=task.pose.orientation_deg,
        accepted=fault is None,
        fault=fault,
        rejected_frames=observer.rejected,
        images=images,
        seed=seed,
        simulated=settings.bench.simulated,
    )
    timing = PoseTiming(pose=task.number, attempt=task.attempt, wall_s=time.perf_counter() - began)
    return Attempt(row, timing, fault, files)


def object_folder(grasps: GraspFile) -> str:
    """Return the object's folder in the data set's layout, e.g. "07_spam"."""
    number = f"{int(grasps.id):02d}" if grasps.id.isdigit() else grasps.id
    return f"{number}_{grasps.name.replace(' ', '_')}"


def _carry_out(
    benches: BenchSource, task: PoseTask, seed: int, plan: PosePlan | HandPose, observer: PoseCapture
) -> str | None:
    """Execute the plan; return None, or the text of the fault."""
    try:
        with benches.for_lift(seed, task.name, task.attempt) as (bench, operator):
            observer.true_masks = true_masks(bench)
            if isinstance(plan, HandPose):
                record_pose_by_hand(bench, operator, plan, observer)
                return None
            make_ready(bench, operator, benches.after_fault)
            operator.place(plan.object_id, plan.object_name)
            record_pose(bench, plan, observer)
    except DeviceError as error:
        return fault_text(error)
    return None


def _images(
    grasps: GraspFile, pose: int, observer: PoseCapture
) -> tuple[tuple[PoseImage, ...], dict[str, bytes]]:
    """Return the row's entries for the captured images, and their files by name, including true masks."""
    images: list[PoseImage] = []
    files: dict[str, bytes] = {}
    for number, (frame, grip_steps, area) in enumerate(observer.taken):
        name = f"{object_folder(grasps)}/image_label/p{pose:02d}_{number + 1:02d}_{frame.serial}.png"
        files[name] = encode_png(frame.image)
        if frame.serial in observer.true_masks:
            files[true_mask_file(Path(name).stem)] = encode_png(observer.masks[number])
        images.append(
            PoseImage(
                file=name,
                grip_counts=grip_steps,
                serial=frame.serial,
                time_s=frame.time_ns / 1e9,
                contact_area_px=area,
            )
        )
    return tuple(images), files
