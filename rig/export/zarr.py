"""Export a trial in the layout of Open-X-Tactile (FTP-1): a Zarr store per object, with all its lifts.

Layout: the page "FTP-1 Data Processing Tutorial" of the repository ftp1-policy, and the cards of the data
sets of Open-X-Tactile. The first axis of all arrays is the time step, at the rate of the external camera.
Arrays whose name begins with `object_angle` are not part of that layout; its loader ignores them.
"""

from collections.abc import Iterator
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.images import decode_stored
from rig.config import BenchConfig
from rig.export.csv_parquet import POSE, WRENCH
from rig.export.episodes import COUNTS_NAME, UNKNOWN_SIGMA_DEG, Episode, read_episode
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.export.rotations import rotation_vectors
from rig.sessions.manifest import TrialManifest, require_kind
from rig.sessions.records import FinishedLift

ZARR_FORMAT = 2
"""Zarr format of the published stores; the package zarr 3 reads formats 2 and 3."""
GRIPPER_SLOT, WRIST_AREA = 28, 15
"""Numbers in the FTP-1 layout: slot of the joint of a gripper, area of a force at the wrist."""
FRAMES_AT_ONCE = 32
"""Number of images per source that are decoded at once, about 30 MB."""
UNITS = {
    "timestamps": "s",
    "right_wrist_pose": "m, rotation vector in rad; base_T_tcp",
    "right_arm_joints": "rad",
    "right_hand_joints": "m, the gripper's opening",
    "right_tactile_data_wrist": "N, N m; force and torque at the TCP in the base's axes",
    "object_angle_deg": "deg, counter-clockwise as the camera sees it, since the grasp; NaN where unknown",
    "object_angle_sigma_deg": "deg, standard deviation of object_angle_deg",
    "object_angle_truth_deg": "deg, from the markers; NaN where unknown",
}


def export_zarr(request: ExportRequest) -> Exported:
    """Write the stores.

    Raises `SessionError` for a session of rig record, `InputError` for images of different sizes.
    """
    why = "a recording has images at rest, no lifts; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    fps, mark, steps = round(manifest.config.camera.rate_hz), simulated_mark(manifest).strip(), 0
    sensors = [sensor.serial for sensor in manifest.config.tactile]
    by_object = sorted(request.finished_lifts, key=attrgetter("object"))
    objects = [(name, list(lifts)) for name, lifts in groupby(by_object, key=attrgetter("object"))]
    for name, lifts in objects:
        root = zarr.open_group(request.out / f"{name}.zarr", mode="w", zarr_format=ZARR_FORMAT)
        root.attrs.update({"session": request.session.name, "simulated": mark or "no", "fps": fps})
        data, ends = root.create_group("data"), list[int]()
        for lift in lifts:
            episode = read_episode(request.session / lift.recording, fps, {})
            _append(data, "sub_task_instruction", np.full(episode.steps, _task(lift), "<U128"))
            _append(data, "right_hand_joints", _openings_m(episode, manifest.config))
            for key, values in _numbers(episode, fps, len(sensors)):
                _append(data, key, values)
            _append_images(data, "camera_main_rgb", [episode.images[manifest.config.camera.serial]])
            _append_images(data, "right_tactile_data_gripper", [episode.images[each] for each in sensors])
            ends.append(episode.steps + (ends[-1] if ends else 0))
        root.create_group("meta").create_array("episode_ends", data=np.array(ends, np.int64))
        steps += ends[-1]
    counts = {"stores": len(objects), "lifts": len(by_object), "steps": steps}
    return Exported(counts, (f"{mark} Zarr, Open-X-Tactile (FTP-1), {fps} steps a second".strip(),))


def _task(lift: FinishedLift) -> str:
    return f"lift the {lift.name} and feel it turn"


def _openings_m(episode: Episode, bench: BenchConfig) -> NDArray[np.float32]:
    """Return the gripper's opening in m, (N, 1).

    Counts are converted, because the loader removes values above 100 as outliers.
    """
    place = len(POSE)
    values = episode.state[:, place]
    if episode.names[place] == COUNTS_NAME:
        gripper, first = bench.gripper_spec(), bench.gripper.limits.min_counts
        values = [gripper.opening_at(float(counts) - first) for counts in values]
    return np.array(values, np.float32)[:, None]


def _numbers(episode: Episode, fps: int, sensors: int) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield names and values of the arrays that depend only on the episode, with one row per step."""
    count, pose = episode.steps, len(POSE)
    rotation = rotation_vectors(episode.state[:, 3:pose])
    yield "timestamps", np.arange(count) / fps
    yield "right_wrist_pose", np.column_stack([episode.state[:, :3], rotation]).astype(np.float32)
    yield "right_arm_joints", episode.joints_rad
    yield "right_hand_joints_idx", np.full((count, 1), GRIPPER_SLOT, np.int32)
    yield from _described("gripper", "DIGIT", "image", list(range(sensors)), count)
    if episode.names[-1] == WRENCH[-1]:
        yield "right_tactile_data_wrist", episode.state[:, None, -len(WRENCH) :]
        yield from _described("wrist", "arm", "state", [WRIST_AREA], count)
    known = episode.angle[:, 2] == 1.0
    measured = known & (episode.angle[:, 1] < UNKNOWN_SIGMA_DEG)
    yield "object_angle_deg", np.where(known, episode.angle[:, 0], np.nan).astype(np.float32)
    yield "object_angle_sigma_deg", np.where(measured, episode.angle[:, 1], np.nan).astype(np.float32)
    yield (
        "object_angle_truth_deg",
        np.where(episode.truth_known, episode.truth_deg, np.nan).astype(np.float32),
    )


def _described(
    group: str, sensor: str, kind: str, areas: list[int], count: int
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays that describe a tactile group."""
    yield f"right_tactile_area_{group}", np.tile(np.array(areas, np.int64), (count, 1))
    yield f"right_tactile_sensor_{group}", np.full(count, sensor, "<U32")
    yield f"right_tactile_type_{group}", np.full(count, kind, "<U16")


def _append_images(data: Any, name: str, sources: list[list[list[bytes]]]) -> None:
    """Append the newest image of each step, (N, H, W, 3) for one source, else (N, sources, H, W, 3)."""
    for first in range(0, len(sources[0]), FRAMES_AT_ONCE):
        blocks = [[decode_stored(w[0]) for w in each[first : first + FRAMES_AT_ONCE]] for each in sources]
        shapes = {image.shape for block in blocks for image in block}
        if len(shapes) != 1:
            raise InputError(f"{name}: the images have different sizes, {sorted(shapes)}; use --to lerobot")
        whole = np.stack([np.stack(block) for block in blocks], axis=1)
        _append(data, name, whole if name.startswith("right_tactile") else whole[:, 0])


def _append(data: Any, name: str, values: NDArray[Any]) -> None:
    """Append values to an array; create the array with its unit if it does not exist.

    The chunk size of images is one step.
    """
    if name in data:
        data[name].append(values)
        return
    chunk = 1 if values.dtype == np.uint8 else max(len(values), 1)
    array = data.create_array(name, data=values, chunks=(chunk, *values.shape[1:]))
    if name in UNITS:
        array.attrs["unit"] = UNITS[name]
