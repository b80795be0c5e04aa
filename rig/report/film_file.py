"""Encode images as a film file, which is written completely or not at all."""

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import chain, islice
from pathlib import Path

import cv2

from drivers.errors import InputError, RecordingError
from drivers.types import Image

H264 = "avc1"
"""Codec of .mp4 files. Many builds of OpenCV, including those on PyPI, have no encoder for it."""
CODECS = {".webm": "VP80", ".mp4": H264, ".avi": "MJPG", ".webp": "WEBP"}
"""Codecs by the file's ending. Browsers play all but .avi; every build of OpenCV writes all but .mp4."""
ANIMATED = ".webp"
"""Ending of an animated image, which web pages show like any image; it is encoded in memory."""
MOST_ANIMATED, _WEBP_QUALITY = 400, 60


@dataclass(frozen=True, slots=True)
class Film:
    """A written film. codec: its four-letter code in OpenCV."""

    path: Path
    frames: int
    codec: str
    size_px: tuple[int, int]


def film_place(out: Path) -> Path:
    """Return the file of a film: the requested one, but a .webm in place of an .mp4 if OpenCV has no H.264.

    Raises `InputError` for an ending without a codec, for a missing folder, and if such a .webm exists
    already.
    """
    if out.suffix.lower() not in CODECS:
        raise InputError(f"{out}: a film's name ends in {' or '.join(CODECS)}")
    if not out.parent.is_dir():
        raise InputError(f"{out.parent}: no such folder; make it, or choose another --out")
    if out.suffix.lower() != ".mp4" or has_h264():
        return out
    other = out.with_suffix(".webm")
    if other.exists():
        raise InputError(
            f"{out}: the installed OpenCV has no H.264 encoder for .mp4, and {other} is there already: give "
            "an --out that ends in .webm"
        )
    return other


@cache
def has_h264() -> bool:
    """Whether the installed OpenCV writes H.264."""
    with tempfile.TemporaryDirectory() as folder, _quiet():
        writer = cv2.VideoWriter(f"{folder}/a.mp4", cv2.VideoWriter.fourcc(*H264), 25.0, (64, 64))
        opened = writer.isOpened()
        writer.release()
    return opened


def save_film(out: Path, pictures: Iterator[Image], fps: float) -> Film:
    """Write images of one size (height x width x 3, RGB) as a film, completely or not at all.

    Raises `RecordingError` if it cannot be written, `InputError` for too many images in an animated one.
    """
    first = next(pictures)
    codec, size = CODECS[out.suffix.lower()], (first.shape[1], first.shape[0])
    aside = out.with_name(f".{out.stem}-{os.getpid()}{out.suffix}")
    try:
        all_pictures = chain([first], pictures)
        if out.suffix.lower() == ANIMATED:
            count, there = _animate(aside, fps, all_pictures), cv2.imcount(str(aside))
        else:
            count, there = _write(aside, codec, fps, size, all_pictures), _pictures_in(aside)
        if there < count:  # OpenCV's writer does not report a full disk
            raise RecordingError(f"{out}: {there} of {count} pictures were written as '{codec}'; free space")
        aside.replace(out)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror}); choose another --out") from error
    finally:
        aside.unlink(missing_ok=True)
    return Film(out, count, codec, size)


def _animate(path: Path, fps: float, pictures: Iterable[Image]) -> int:
    frames = [cv2.cvtColor(p, cv2.COLOR_RGB2BGR) for p in islice(pictures, MOST_ANIMATED + 1)]
    if len(frames) > MOST_ANIMATED:
        raise InputError(
            f"{path.suffix} takes {MOST_ANIMATED} pictures at most; give a lower --fps, a higher --speed "
            "or an --out that ends in .webm"
        )
    animation = cv2.Animation()
    animation.frames = frames
    animation.durations = [round(1000 / fps)] * len(frames)
    _, encoded = cv2.imencodeanimation(ANIMATED, animation, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])
    path.write_bytes(encoded.tobytes())
    return len(frames)


def _write(path: Path, codec: str, fps: float, size: tuple[int, int], pictures: Iterable[Image]) -> int:
    path.touch()  # raises an error with the reason, which the writer does not
    with _quiet():
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, size)
    count = 0
    try:
        for picture in pictures:
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            count += 1
    finally:
        writer.release()
    return count


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress messages of OpenCV's libraries on standard error, such as a harmless one about WebM's tag."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _pictures_in(path: Path) -> int:
    film, there = cv2.VideoCapture(str(path)), 0
    try:
        while film.grab():
            there += 1
    finally:
        film.release()
    return there
