"""Public sets of tactile recordings with known turns, read in the layouts in which they are published.

TactileTracking (GelSight Mini, motion capture; huggingface.co/datasets/joehjhuang/TactileTracking; the layout
as its code reads it, github.com/rpl-cmu/normalflow_experiment): a folder per trial with `gelsight.avi` of N
frames, `true_start_T_currs.npy`, (N, 4, 4), the sensor's pose in its first one's, and `contact_masks.npy`,
(N, h, w). Every frame shows contact. The sensor's x and y are the image's, y down, so what it turns about z
clockwise as seen turns the object, which is fixed, counter-clockwise: the object's image angle is the turn
about z.

digit-pose-estimation (DIGIT, a tag on the object; huggingface.co/datasets/facebook/digit-pose-estimation; the
layout as its code reads it, github.com/facebookresearch/sparsh): a pickle per sequence with `digit_index`,
`digit_middle` and `digit_ring`, lists of encoded or decoded images, lying, and `object_<finger>_rel_pose_n5`,
(M, 4, 4), each the object's change over the last five samples in the finger's axes; `bgs/digit_<finger>.png`
beside, without contact. Neither rate nor the sense of the finger's z as the image shows it is told.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeGuard

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import FormatError, InputError, counted
from drivers.formats import read_bounded, reason
from drivers.images import decode_image, read_image
from drivers.types import Image
from rig.frames.plain_pickle import read_plain_pickle

TRIAL_VIDEO, TRIAL_POSES, TRIAL_MASKS = "gelsight.avi", "true_start_T_currs.npy", "contact_masks.npy"
BAG_SUFFIX, BACKGROUNDS = ".pkl", "bgs"
FINGERS = ("index", "middle", "ring")
BAG_STRIDE = 5
"""Samples over which a bag's changes of pose are."""
MOST_BYTES = 2_000_000_000
"""Of a file of these sets; their largest has a fifth of it."""
NOT_A_TURN = 0.01
MASKS_USED, GROWN_PX, FILLED_PX = 60, 9, 5
"""Frames a background is made of; how far a contact's surroundings reach; what is filled looks so far."""

Matrices = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """One finger of a bag: its images, encoded or (H, W, 3), and the (M, 4, 4) changes of pose."""

    path: Path
    finger: str
    images: list[Any]
    changes: Matrices

    def frames(self) -> Iterator[Image | None]:
        """Yield the images upright, (H, W, 3) uint8 RGB; None for one that cannot be decoded."""
        return (_upright(image) for image in self.images)

    def turned_deg(self) -> NDArray[np.float64]:
        """(K,) turn about the finger's z since the first sample, at samples 0, 5, 10 and so on.

        As the set's own code pairs them: a change belongs to the sample at which it ends.
        """
        ends = range(BAG_STRIDE, min(len(self.images), len(self.changes)), BAG_STRIDE)
        return np.cumsum([0.0, *(_about_z_deg(self.changes[end]) for end in ends)])

    def background(self) -> Image | None:
        """The finger's frame without contact, from `bgs` of this folder or one above; None without one."""
        for folder in (self.path.parent, *self.path.parent.parents[:3]):
            file = folder / BACKGROUNDS / f"digit_{self.finger}.png"
            if file.is_file():
                return _upright(read_image(file))
        return None


def is_trial(path: Path) -> bool:
    """Whether a folder is a trial of TactileTracking."""
    return (path / TRIAL_VIDEO).is_file() and (path / TRIAL_POSES).is_file()


def trial_turns_deg(folder: Path, frames: int) -> NDArray[np.float64]:
    """Return (N,) image angles of a trial's object, 0 at the first frame, counter-clockwise as seen.

    frames: how many the video has. Raises `InputError` where the poses are not as many, or none.
    """
    path = folder / TRIAL_POSES
    poses = _matrices(path, _array(path))
    if len(poses) != frames:
        raise InputError(
            f"{path}: {counted(len(poses), 'pose')} for {counted(frames, 'frame')}: copy the trial again"
        )
    about_z = np.radians([_about_z_deg(np.linalg.inv(poses[0]) @ pose) for pose in poses])
    return np.degrees(np.unwrap(about_z))


def trial_background(folder: Path, images: Iterator[Image]) -> Image:
    """Make a trial's frame without contact: the mean of what lies outside the contacts, else filled in.

    Raises `InputError` where the masks are missing or not of these frames.
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


def bag_of(path: Path) -> tuple[Path, str] | None:
    """Tell the file and the finger that `bag_00.pkl` or `bag_00.pkl:ring` names; None for no such file."""
    name, _, finger = str(path).rpartition(":")
    if name.endswith(BAG_SUFFIX) and finger in FINGERS:
        return Path(name), finger
    return (path, FINGERS[0]) if path.suffix == BAG_SUFFIX else None


def read_bag(path: Path, finger: str) -> Bag:
    """Read one finger of a sequence of digit-pose-estimation; runs no code in it. Raises `InputError`."""
    content = _unpickled(path)
    images, changes = content.get(f"digit_{finger}"), content.get(f"object_{finger}_rel_pose_n{BAG_STRIDE}")
    if isinstance(changes, list) and {getattr(change, "shape", None) for change in changes} == {(4, 4)}:
        changes = np.array(changes)
    if not _several(images) or changes is None:
        raise FormatError(
            f"{path}: has no digit_{finger} with object_{finger}_rel_pose_n{BAG_STRIDE}: give a sequence of "
            "digit-pose-estimation"
        )
    if not isinstance(changes, np.ndarray):
        raise FormatError(f"{path}: object_{finger}_rel_pose_n{BAG_STRIDE} is no array: copy it again")
    return Bag(path, finger, list(images), _matrices(path, changes))


def _several(images: object) -> TypeGuard[Sequence[Any]]:
    """Whether a value is a list of images or an array of them, (N, H, W, 3), and not empty."""
    if isinstance(images, np.ndarray):
        return images.ndim == 4 and len(images) > 0
    return isinstance(images, (list, tuple)) and len(images) > 0


@lru_cache(maxsize=1)
def _unpickled(path: Path) -> dict[str, Any]:
    """Read a file once for its three fingers: it takes seconds, and as much memory as it is large."""
    data = read_bounded(path, MOST_BYTES)
    try:
        content = read_plain_pickle(data)
    except FormatError as error:
        raise FormatError(f"{path}: is no sequence of digit-pose-estimation ({error})") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path}: holds a {type(content).__name__}, no sequence of digit-pose-estimation")
    return content


def _array(path: Path) -> NDArray[Any]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: is larger than any file of TactileTracking")
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an array ({reason(error)}): copy it again") from error


def _matrices(path: Path, values: NDArray[Any]) -> Matrices:
    """Return rigid motions, (N, 4, 4). Raises `InputError`."""
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
        raise InputError(f"{path}: holds a matrix that is no rigid motion: copy it again")
    return matrices


def _about_z_deg(matrix: Matrices) -> float:
    """The turn about z alone, whatever it tilts (the twist of swing and twist), degrees."""
    _, _, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True)
    return math.degrees(2.0 * math.atan2(z, w))


def _free(mask: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Where nothing is touched, nor near it."""
    whole = cv2.resize((np.asarray(mask) > 0).astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.dilate(whole, np.ones((2 * GROWN_PX + 1, 2 * GROWN_PX + 1), np.uint8)) == 0


def _upright(image: Any) -> Image | None:
    """Decode where needed; turn what lies on its side by 90 degrees clockwise, as the set's own code does."""
    found = decode_image(bytes(image)) if isinstance(image, (bytes, bytearray)) else image
    if not isinstance(found, np.ndarray) or found.dtype != np.uint8 or found.ndim != 3 or found.shape[2] != 3:
        return None
    lying = found.shape[0] < found.shape[1]
    return np.ascontiguousarray(np.rot90(found, -1)) if lying else np.ascontiguousarray(found)
