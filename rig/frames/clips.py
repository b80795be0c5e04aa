"""A clip as a folder: its frames or its video, the frame without contact and the labels beside them."""

import re
from pathlib import Path

from drivers.errors import InputError
from drivers.images import SUFFIXES
from rig.frames.array_files import ARRAY_SUFFIXES
from rig.sessions.layout import RESULTS, first_bytes, is_recording, is_ros_file

FRAMES, BACKGROUND, LABELS = "frames", "background", "labels.csv"
VIDEO_ENDINGS = {
    ".avi", ".mp4", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".wmv", ".flv", ".ogv",
    ".mjpeg", ".mjpg",
}  # fmt: skip
"""Only such files are read as videos: OpenCV finds pictures in any file that holds JPEG data."""


def is_ros_bag(path: Path) -> bool:
    """Whether a path is a ROS bag: a folder with its metadata, or a file by its first bytes."""
    return (path / "metadata.yaml").is_file() or is_ros_file(first_bytes(path))


def clip_frames(folder: Path) -> Path:
    """Return a clip's folder of frames, or its one video or ROS bag. Raises `InputError`."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: give a clip's")
    if (folder / FRAMES).is_dir():
        return folder / FRAMES
    videos = sorted(p for p in folder.iterdir() if p.suffix.lower() in VIDEO_ENDINGS or is_ros_bag(p))
    if len(videos) != 1:
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


def require_clip(path: Path) -> None:
    """Raise `InputError` if a path is certainly not a clip of one sensor."""
    is_device = path.exists() and not path.is_dir() and not path.is_file()
    if is_device or (not path.exists() and re.match(r"[a-z][a-z0-9]+:/", str(path))):
        raise InputError(f"{path}: a stream or a device has no end: record a clip of it and give that")
    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder: check the path")
    if is_recording(path):
        raise InputError(
            f"{path}: is a recording of several sensors, no clip of one: use rig estimate {path}, or give "
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
                f"{path}: images of a recording session, of several sensors and poses, no clip: give the "
                "frames of one sensor in their order"
            )
