"""A clip as a folder: its frames or its video, the frame without contact and the labels beside them."""

from pathlib import Path

from drivers.errors import InputError
from drivers.images import SUFFIXES

FRAMES, BACKGROUND, LABELS = "frames", "background", "labels.csv"
VIDEO_ENDINGS = {".mov", ".mp4", ".avi", ".mkv", ".webm", ".m4v"}


def clip_frames(folder: Path) -> Path:
    """Return a clip's folder of frames, or its one video. Raises `InputError`."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: give a clip's")
    if (folder / FRAMES).is_dir():
        return folder / FRAMES
    videos = sorted(path for path in folder.iterdir() if path.suffix.lower() in VIDEO_ENDINGS)
    if len(videos) != 1:
        raise InputError(
            f"{folder}: {len(videos)} videos and no folder '{FRAMES}': give a clip, keep one of them"
        )
    return videos[0]


def clip_background(folder: Path) -> Path | None:
    """Return a clip's frame without contact, `background.*`; None without one. Raises `InputError`."""
    files = [path for path in folder.glob(f"{BACKGROUND}.*") if path.suffix.lower() in SUFFIXES]
    if len(files) > 1:
        raise InputError(f"{folder}: {len(files)} images named '{BACKGROUND}': keep one, without contact")
    return files[0] if files else None
