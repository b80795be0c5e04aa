"""A clip's files: its frames as images, a video or a NumPy array; the background and labels beside them.

Also the trials of a public set with known rotation. TactileTracking: GelSight Mini with motion capture,
huggingface.co/datasets/joehjhuang/TactileTracking. The layout is the one that its code reads,
github.com/rpl-cmu/normalflow_experiment. Each trial is a folder with

- `gelsight.avi`: N frames, all with contact,
- `true_start_T_currs.npy`: (N, 4, 4), poses of the sensor relative to its pose in the first frame,
- `contact_masks.npy`: (N, h, w).

The sensor's x and y axes are those of the image, y down. The object is fixed, and the sensor moves. If the
sensor rotates clockwise as seen, the object rotates counter-clockwise in the image. The image angle of the
object is therefore the sensor's rotation about z.
"""

import lzma
import math
import re
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from drivers.errors import FormatError, InputError, no_such, plural
from drivers.formats import MOST_PIXELS, check_zip, read_json, reason
from drivers.images import SUFFIXES, require_same_aspect
from drivers.types import Image
from rig.sessions.files import RESULTS, first_bytes, is_recording, is_ros_file

FRAMES, BACKGROUND, LABELS, TIMES = "frames", "background", "labels.csv", "timestamps.csv"
ABOUT = "clip.json"
"""Metadata of a clip that `rig live` has recorded; its key `simulated` is true for a simulated sensor."""
VIDEO_ENDINGS = {
    ".avi", ".mp4", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".wmv", ".flv", ".ogv",
    ".mjpeg", ".mjpg", ".h264", ".264", ".h265", ".265", ".hevc",
}  # fmt: skip
"""Only files with these endings are read as videos: OpenCV finds images in any file with JPEG data."""
_FIRST_UNITS = (0x06, 0x09, 0x27, 0x47, 0x67, 0x40, 0x42, 0x46, 0x4E)
"""Units that begin a stream, H.264: SEI, delimiter, SPS; H.265: VPS, SPS, delimiter, SEI."""
ARRAY_SUFFIXES = (".npy", ".npz")
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_DAMAGE = (
    OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError, MemoryError, SyntaxError, OverflowError,
    tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""Exceptions that numpy and zipfile raise for damaged files."""


def is_ros_bag(path: Path) -> bool:
    """Whether a path is a ROS bag: a folder with a bag's metadata, or a file that starts as a bag does."""
    return (path / "metadata.yaml").is_file() or is_ros_file(first_bytes(path))


def is_raw_video(path: Path) -> bool:
    """Whether a video is a raw stream without times: JPEGs in a row, or H.264 or H.265 (Annex B)."""
    begin = first_bytes(path)
    if begin.startswith((b"\xff\xd8", b"--")):  # JPEG; the boundary of a stored HTTP stream
        return True
    head = begin.lstrip(b"\0")[:2]
    return begin.startswith(b"\0\0") and len(head) == 2 and head[0] == 1 and head[1] in _FIRST_UNITS


def clip_frames(folder: Path) -> Path:
    """Return a clip's folder of frames, or its only video or ROS bag. Raises `InputError`."""
    if not folder.is_dir():
        raise InputError(no_such(folder, "folder", "give a clip's"))
    if (folder / FRAMES).is_dir():
        return folder / FRAMES
    videos = sorted(p for p in folder.iterdir() if p.suffix.lower() in VIDEO_ENDINGS or is_ros_bag(p))
    if not videos:
        raise InputError(
            f"{folder}: is no clip, it has neither a folder '{FRAMES}' nor a video: give the folder of the "
            "clip, not its parent and not the folder with the images"
        )
    if len(videos) > 1:
        raise InputError(
            f"{folder}: {len(videos)} videos and no folder '{FRAMES}' (a ROS bag counts as a video): give a "
            "clip, keep one of them"
        )
    return videos[0]


def clip_background(folder: Path) -> Path | None:
    """Return a clip's frame without contact, `background.*`; None without one. Raises `InputError`."""
    files = [path for path in folder.glob(f"{BACKGROUND}.*") if path.suffix.lower() in SUFFIXES]
    if len(files) > 1:
        raise InputError(f"{folder}: {len(files)} images named '{BACKGROUND}': keep one, without contact")
    return files[0] if files else None


def is_simulated_clip(path: Path) -> bool:
    """Whether a clip, or the clip that a folder of frames belongs to, is of a simulated sensor.

    Raises `InputError` if its metadata are damaged.
    """
    for file in (path / ABOUT, path.absolute().parent / ABOUT):
        if path.is_dir() and file.is_file():
            try:
                about = read_json(file)
            except FormatError as error:
                raise InputError(f"{error}: copy the clip again, or delete this file") from error
            return isinstance(about, dict) and about.get("simulated") is True
    return False


def require_clip(path: Path) -> None:
    """Raise `InputError` if a path cannot be a clip of one sensor."""
    is_device = path.exists() and not path.is_dir() and not path.is_file()
    if is_device or (not path.exists() and re.match(r"[a-z][a-z0-9]+:/", str(path))):
        raise InputError(f"{path}: a stream or a device has no end: record a clip of it and give that")
    if not path.exists():
        raise InputError(no_such(path))
    if is_recording(path):
        raise InputError(
            f"{path}: is a recording of several sensors, not a clip of one: use rig estimate {path}, or give "
            "its session folder"
        )
    known = (*SUFFIXES, *ARRAY_SUFFIXES, *VIDEO_ENDINGS)
    if path.is_file() and path.suffix.lower() not in known:
        raise InputError(
            f"{path}: neither images nor a video that can be read: give a folder of images, a video "
            "(.avi, .mp4, .mkv, .webm ...), an array (.npy, .npz), a recording (.mcap) or a ROS bag"
        )
    for folder in path.absolute().parents[:3] if path.is_dir() else ():
        if (folder / RESULTS["record"]).is_file():
            raise InputError(
                f"{path}: images of several sensors and poses from a recording session, not a clip: give the "
                "frames of one sensor in order"
            )


def array_shape(path: Path) -> tuple[int, int, int]:
    """Return the number of frames, their height and their width. Raises `InputError`."""
    with _open_array(path) as (_, shape):
        return shape


def array_frames(path: Path) -> Iterator[Image]:
    """Yield the frames one by one, (H, W, 3) uint8 RGB, without loading all. Raises `InputError`."""
    with _open_array(path) as (stream, (count, height, width)):
        for _ in range(count):
            data = stream.read(height * width * 3)
            if len(data) < height * width * 3:
                raise EOFError("it is cut short")
            yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


@contextmanager
def _open_array(path: Path) -> Iterator[tuple[IO[bytes], tuple[int, int, int]]]:
    """Open a file and read its array's header; give the stream at the first frame, and (T, H, W)."""
    try:
        with ExitStack() as stack:
            if path.suffix.lower() == ".npz":
                archive = stack.enter_context(zipfile.ZipFile(path))
                check_zip(str(path), archive)
                inside = archive.infolist()
                if len(inside) != 1:
                    raise ValueError(f"it holds {len(inside)} arrays, not one")
                stream, size = stack.enter_context(archive.open(inside[0])), inside[0].file_size
            else:
                stream, size = stack.enter_context(path.open("rb")), path.stat().st_size
            yield stream, _shape(stream, size)
    except FormatError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path}: cannot be read as frames ({reason(error)}): save one array (T, H, W, 3) of uint8, RGB"
        ) from error


def _shape(stream: IO[bytes], size: int) -> tuple[int, int, int]:
    version = npy.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"its format is {version[0]}.{version[1]}")
    shape, fortran, kind = _HEADERS[version](stream)
    if kind != np.uint8 or len(shape) != 4 or shape[3] != 3 or min(shape) < 1:
        raise ValueError(f"it is {kind} of shape {shape}")
    if fortran or shape[1] * shape[2] > MOST_PIXELS:
        raise ValueError(
            "its frames are not stored one after another" if fortran else "its frames are too large"
        )
    if math.prod(shape) > size - stream.tell():
        raise ValueError("it is cut short")
    return shape[:3]


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
    from scipy.spatial.transform import Rotation  # imported here, because it is slow

    path = folder / TRIAL_POSES
    poses = _matrices(path, _array(path))
    if len(poses) != frames:
        raise InputError(
            f"{path}: {plural(len(poses), 'pose')} for {plural(frames, 'frame')}: copy the trial again"
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
