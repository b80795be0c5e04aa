"""Read a public set of tactile recordings with known rotation, in its published layout.

TactileTracking: GelSight Mini with motion capture, huggingface.co/datasets/joehjhuang/TactileTracking. The
layout is the one that its code reads, github.com/rpl-cmu/normalflow_experiment. Each trial is a folder with

- `gelsight.avi`: N frames, all with contact,
- `true_start_T_currs.npy`: (N, 4, 4), poses of the sensor relative to its pose in the first frame,
- `contact_masks.npy`: (N, h, w).

The sensor's x and y axes are those of the image, y down. The object is fixed, and the sensor moves. If the
sensor rotates clockwise as seen, the object rotates counter-clockwise in the image. The image angle of the
object is therefore the sensor's rotation about z.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import InputError, counted
from drivers.formats import reason
from drivers.images import require_same_aspect
from drivers.types import Image

TRIAL_VIDEO, TRIAL_POSES, TRIAL_MASKS = "gelsight.avi", "true_start_T_currs.npy", "contact_masks.npy"
MOST_BYTES = 2_000_000_000
"""Size limit for an array file of the set: a file of another kind is rejected before it takes memory."""
NOT_A_TURN = 0.01
"""Largest deviation of a rotation matrix from an orthogonal one."""
MASKS_USED, GROWN_PX, FILLED_PX = 60, 9, 5
"""Number of frames for a background; margin around a contact that is left out; radius of the inpainting."""

Matrices = NDArray[np.float64]


def is_trial(path: Path) -> bool:
    return (path / TRIAL_VIDEO).is_file() and (path / TRIAL_POSES).is_file()


def trial_turns_deg(folder: Path, frames: int) -> NDArray[np.float64]:
    """Return (N,) image angles of a trial's object, 0 at the first frame, counter-clockwise as seen.

    frames: number of frames in the video. Raises `InputError` if the number of poses differs or is 0.
    """
    path = folder / TRIAL_POSES
    poses = _matrices(path, _array(path))
    if len(poses) != frames:
        raise InputError(
            f"{path}: {counted(len(poses), 'pose')} for {counted(frames, 'frame')}: copy the trial again"
        )
    turns_deg = []
    for pose in poses:  # the rotation about z is the twist of the swing-twist decomposition
        turn = Rotation.from_matrix((np.linalg.inv(poses[0]) @ pose)[:3, :3])
        _, _, z, w = turn.as_quat(canonical=True)
        turns_deg.append(math.degrees(2.0 * math.atan2(z, w)))
    return np.degrees(np.unwrap(np.radians(turns_deg)))


def trial_background(folder: Path, images: Iterator[Image]) -> Image:
    """Make a trial's frame without contact: for each pixel the mean of the frames in which it is untouched.

    Pixels that are always touched are filled in from their surroundings. Raises `InputError` if the masks are
    missing or do not fit the frames.
    """
    masks = _array(folder / TRIAL_MASKS)
    if masks.ndim != 3:
        raise InputError(f"{folder / TRIAL_MASKS}: has shape {masks.shape}, not (N, h, w): copy it again")
    total: NDArray[np.float64] | None = None
    seen: NDArray[np.float64] | None = None
    step = max(1, len(masks) // MASKS_USED)
    for number, image in enumerate(images):
        if number % step or number >= len(masks):
            continue
        require_same_aspect(str(folder / TRIAL_MASKS), (masks.shape[2], masks.shape[1]), image.shape)
        free = _free(masks[number], image.shape[:2])
        total = np.zeros(image.shape) if total is None else total
        seen = np.zeros(image.shape[:2]) if seen is None else seen
        total += image * free[..., None]
        seen += free
    if total is None or seen is None or not seen.any():
        raise InputError(f"{folder}: no part of any frame is without contact: put a background.png beside it")
    mean = np.rint(total / np.maximum(seen, 1.0)[..., None]).astype(np.uint8)
    unseen = (seen == 0).astype(np.uint8)
    return np.asarray(cv2.inpaint(mean, unseen, FILLED_PX, cv2.INPAINT_TELEA), np.uint8)


def _array(path: Path) -> NDArray[Any]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: is larger than any file of TactileTracking")
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an array ({reason(error)}): copy it again") from error


def _matrices(path: Path, values: NDArray[Any]) -> Matrices:
    """Check and return rigid transforms, (N, 4, 4). Raises `InputError`."""
    if values.ndim != 3 or values.shape[1:] != (4, 4) or not len(values) or values.dtype.kind not in "fiu":
        raise InputError(f"{path}: poses have shape {values.shape}, not (N, 4, 4): copy it again")
    matrices = np.asarray(values, np.float64)
    turns = matrices[:, :3, :3]
    off = (
        np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max()
        if np.isfinite(matrices).all()
        else math.inf
    )
    if not off < NOT_A_TURN or (np.linalg.det(turns) < 0).any():
        raise InputError(f"{path}: holds a matrix that is not a rigid transform: copy it again")
    return matrices


def _free(mask: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the pixels that are farther than `GROWN_PX` from any contact, as (H, W) bool."""
    whole = cv2.resize((np.asarray(mask) > 0).astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.dilate(whole, np.ones((2 * GROWN_PX + 1, 2 * GROWN_PX + 1), np.uint8)) == 0
