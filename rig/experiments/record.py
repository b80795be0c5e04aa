"""Record grasp poses of one object: a session with images in the layout of the public data set.

The layout is that of the paper's data set (VISTASE): a folder per object with `image_label`, in which LabelMe
stores its polygons beside the images.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import DeviceError, InputError, SessionError
from drivers.images import encode_png, load_image
from drivers.types import Frame, Image, Pose
from protocols.grasps import GraspFile, GraspPose, grasp_poses
from protocols.observer import LiftEvents
from protocols.readiness import free_hand, make_ready
from protocols.record_grasps import (
    CaptureObserver,
    HandPose,
    PosePlan,
    record_pose,
    record_pose_by_hand,
    record_reference,
    record_untouched,
)
from protocols.steps import TRAVEL_SPEED_M_S, home_plan, way_to
from rig.bench.assembly import home_pose, simulated_layout, true_masks
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import BenchSource, FreshBenches
from rig.bench.twins import plain_notes, refuse_undrawn
from rig.config import BenchConfig
from rig.experiments.attempts import Attempt, Progress, Run, Task, fault_text, run_session
from rig.experiments.lift_plan import derived_seed, grasp_pose, refuse_impossible
from rig.live.feed import Listener
from rig.live.observer import PictureSender
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.files import reference_file, true_mask_file
from rig.sessions.manifest import RecordManifest, begun_on
from rig.sessions.records import IMAGE_COLUMNS, POSES, PoseImage, PoseRow, PoseTiming, image_lines
from rig.sessions.session import Session
from rig.sessions.table_files import csv_bytes
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.gate import TouchDebounce
from rig.terminal.screen import begin_phase

GRIPS_PER_POSE = 5
"""Most different grips of one pose."""
FRAMES_APART = 3
"""Images of one grip are this many frames apart, so that they differ by more than noise."""


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
        return derived_seed(self.seed, "sensors") if self.randomise else None


@dataclass(frozen=True, slots=True)
class PoseTask(Task):
    """One pose to record, and the number of its images. number: of the pose in the object's file, from 1."""

    pose: GraspPose
    images: int


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

    In a recording by hand, return the requests to the person. Raises `InputError` for an object that cannot
    be grasped here.
    """
    bench, grasps, tasks = settings.bench, settings.grasps, _all_tasks(settings)
    head, motions = plain_notes(bench, [grasps]), []
    if settings.by == "hand":
        poses = [hand_pose(settings, task) for task in tasks]
        head += [
            f"Nothing moves. You press object {grasps.id} ({grasps.name}) by hand onto "
            f"{' and then '.join(tip.serial for tip in bench.tactile)}, in each of these poses, and confirm "
            "when it is pressed:",
            *(f"  {n:>2} {p.position} at {p.orientation_deg:+.0f} deg" for n, p in enumerate(poses, 1)),
        ]
        return make_plan(bench, head, motions)
    home, step_m = home_pose(bench), bench.gripper_spec().resolution_m
    head += [
        home_plan(home, "Before each pose"),
        f"The arm will move at up to {TRAVEL_SPEED_M_S} m/s to these grasps (base frame). Grip: how far the "
        "fingers close past first contact.",
    ]
    for task in tasks:
        plan = arm_pose(settings, task)
        what = (
            f"{task.number:>2} {task.pose.position.name} at {task.pose.orientation_deg:+.0f} deg, "
            f"grip up to {1e3 * plan.grips[-1][0] * step_m:.1f} mm"
        )
        way = way_to(home, plan.base_T_grasp)
        motions.append(PlannedMotion(what, plan.base_T_grasp, way, TRAVEL_SPEED_M_S))
    return make_plan(bench, head, motions)


def run_record(
    folder: Path,
    settings: RecordSettings,
    resume: bool = False,
    benches: BenchSource | None = None,
    progress: Progress[PoseRow] = lambda done, total, row: None,
    remarks: Remarks = NO_REMARKS,
    live: Sequence[Listener] = (),
) -> list[PoseRow]:
    """Record the unfinished poses; return the rows of all attempts.

    benches: source of the bench for each pose (`session_bench`); None for simulated ones. remarks: stored
    with the session. live: viewers. Raises `InputError` for impossible numbers, `DeviceError` after three
    faults in a row; finished poses stay on disk, and `resume` continues from them.
    """
    benches = benches or FreshBenches(settings.bench, variation_seed=settings.variation_seed)

    def prepare(session: Session[PoseRow], left: int) -> Callable[[PoseTask], Attempt[PoseRow]]:
        return partial(attempt_pose, settings, _references(session, settings, benches), benches, live=live)

    run = Run(
        session="recording",
        piece="pose",
        manifest=record_manifest(settings, remarks),
        codec=POSES,
        tasks=_all_tasks(settings),
        prepare=prepare,
        table=("images.csv", lambda rows: csv_bytes(IMAGE_COLUMNS, image_lines(rows))),
        logged=lambda row: f"pose {row.pose}: {len(row.images)} images",
    )
    return run_session(folder, run, resume, benches, progress)


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
        PoseTask(pose.number, settings.grasps.id, pose, share + (i < rest))
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
    finders: dict[str, ContactFinder] = {}
    for serial, name in names.items():
        path = session.folder / name
        image = load_image(path)
        if image is None:
            raise SessionError(f"{path}: the reference image cannot be read; record into a new --out")
        finders[serial] = ContactFinder(image)
    return finders


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
    pose, images, base_T_table = task.pose, task.images, Pose(settings.bench.require("table").position_m)  # noqa: N806
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
    live: Sequence[Listener] = (),
) -> Attempt[PoseRow]:
    """Record one pose. A device failure gives a row that is not accepted; no other error is caught.

    finders: of contacts, by serial. live: viewers.
    """
    began = time.perf_counter()
    seed = derived_seed(settings.seed, task.object_id, "pose", task.number, attempt=task.attempt)
    plan = hand_pose(settings, task) if settings.by == "hand" else arm_pose(settings, task)
    fault: str | None = None
    with closing(PictureSender(live)) as pictures:
        observer = PoseCapture(finders, shown=pictures if live else None)
        try:
            with benches.for_lift(seed, task.name, task.attempt) as (bench, operator):
                observer.true_masks = true_masks(bench)
                if isinstance(plan, HandPose):
                    record_pose_by_hand(bench, operator, plan, observer)
                else:
                    make_ready(bench, operator, benches.after_fault)
                    operator.place(plan.object_id, plan.object_name)
                    record_pose(bench, plan, observer)
        except DeviceError as error:
            fault = fault_text(error)
    if fault:
        benches.note_displaced()
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
    return Attempt(row, timing, files)


def _images(
    grasps: GraspFile, pose: int, observer: "PoseCapture"
) -> tuple[tuple[PoseImage, ...], dict[str, bytes]]:
    """Return the row's entries for the captured images, and their files by name, including true masks.

    The object's folder is named as in the data set's layout, e.g. "07_spam".
    """
    number = f"{int(grasps.id):02d}" if grasps.id.isdigit() else grasps.id
    folder = f"{number}_{grasps.name.replace(' ', '_')}/image_label"
    images: list[PoseImage] = []
    files: dict[str, bytes] = {}
    for count, (frame, grip_steps, area) in enumerate(observer.taken, 1):
        stem = f"p{pose:02d}_{count:02d}_{frame.serial}"
        name = f"{folder}/{stem}.png"
        files[name] = encode_png(frame.image)
        if frame.serial in observer.true_masks:
            files[true_mask_file(stem)] = encode_png(observer.masks[count - 1])
        images.append(
            PoseImage(
                file=name,
                grip_counts=grip_steps,
                serial=frame.serial,
                time_s=frame.time_ns / NS_PER_S,
                contact_area_px=area,
            )
        )
    return tuple(images), files


@dataclass(slots=True)
class PoseCapture(CaptureObserver):
    """An observer that captures images with contact, alternately from each fingertip or from one alone.

    taken: frames with their grip in steps beyond first contact (None: pressed by hand) and contact area, px.
    true_masks: functions that give the true contact mask of simulated fingertips at a time in ns; masks:
    those of the captured images. They do not influence the capture. shown: called with each frame after it
    was processed.
    """

    finders: dict[str, ContactFinder]
    taken: list[tuple[Frame, int | None, float]] = field(default_factory=list)
    true_masks: dict[str, Callable[[int], Image]] = field(default_factory=dict)
    masks: list[Image] = field(default_factory=list)
    rejected: int = 0
    shown: Callable[[Frame], None] | None = None
    _grip_steps: int | None = 0
    _serial: str | None = None
    _wanted: int = 0
    _touches: dict[str, TouchDebounce] = field(default_factory=dict)
    _last: dict[str, int] = field(default_factory=dict)

    def want(self, images: int, grip_steps: int | None = None, serial: str | None = None) -> None:
        self._wanted, self._grip_steps, self._serial = len(self.taken) + images, grip_steps, serial

    def is_complete(self) -> bool:
        return len(self.taken) >= self._wanted

    def touching(self, serial: str) -> bool:
        return serial in self._touches and self._touches[serial].sure

    def frame(self, frame: Frame) -> None:
        self._capture(frame)
        if self.shown is not None:
            self.shown(frame)

    def _capture(self, frame: Frame) -> None:
        finder = self.finders.get(frame.serial)
        if finder is None:
            return
        area = finder.find(frame.image).area_px
        self._touches.setdefault(frame.serial, TouchDebounce()).update(area > 0)
        if self.is_complete() or not self._due(frame):
            return
        if area > 0:
            self.taken.append((frame, self._grip_steps, area))
            if frame.serial in self.true_masks:
                self.masks.append(self.true_masks[frame.serial](frame.time_ns))
        else:
            self.rejected += 1
        self._last[frame.serial] = frame.sequence

    def _due(self, frame: Frame) -> bool:
        if frame.sequence - self._last.get(frame.serial, -FRAMES_APART) < FRAMES_APART:
            return False
        if self._serial is not None:
            return frame.serial == self._serial
        counts = {serial: sum(f.serial == serial for f, _, _ in self.taken) for serial in self.finders}
        return counts[frame.serial] == min(counts.values())


@dataclass(slots=True)
class ReferenceCapture(LiftEvents):
    """An observer that collects the fingertips' frames without contact."""

    frames: dict[str, list[Image]]

    def frame(self, frame: Frame) -> None:
        if frame.serial in self.frames:
            self.frames[frame.serial].append(frame.image)
