"""Recorded frames as a source: a folder of images or a video file, played at its frame rate."""

import threading
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.errors import DeviceError, InputError
from drivers.images import check_video_size, images_in_order, require_single
from drivers.video.stream import FrameStream, RawFrame

PLAYED_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Image types that are played: those that a camera could have sent. Other images in a folder are skipped."""


class RecordedStream(FrameStream):
    """Common base of folders and videos: image n is due n periods after the first."""

    warm_up = 0
    stamp = "schedule"
    ends = True

    def __init__(self, path: Path, rate_hz: float, clock: Clock) -> None:
        self._path, self._rate_hz, self._clock = path, rate_hz, clock
        self._start_ns: int | None = None
        self._number = 0
        self._stopped = threading.Event()

    def interrupt(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        """Do nothing: no resource is held."""

    def _await_next(self, after_s: float) -> tuple[int, int]:
        """Wait until the next image is due, `after_s` after the first; return its number and its time."""
        if self._start_ns is None:
            self._start_ns = self._clock.now_ns()
        due_ns = self._start_ns + round(after_s * NS_PER_S)
        self._stopped.wait(max(due_ns - self._clock.now_ns(), 0) / NS_PER_S)
        if self._stopped.is_set():
            raise DeviceError(f"{self._path}: stopped")
        self._number += 1
        return self._number - 1, due_ns

    def _end_error(self) -> DeviceError:
        return DeviceError(
            f"{self._path}: all {self._number} images have been played; start again to replay them"
        )


class FolderStream(RecordedStream):
    """Plays the JPEG and PNG files of a folder bit for bit, sorted by name (numbers by value)."""

    def __init__(self, path: Path, rate_hz: float, clock: Clock) -> None:
        super().__init__(path, rate_hz, clock)
        self._files = image_files(path)

    def read(self) -> RawFrame:
        if self._number >= len(self._files):
            raise self._end_error()
        number, due_ns = self._await_next(self._number / self._rate_hz)
        try:
            data = self._files[number].read_bytes()
        except OSError as error:
            raise DeviceError(f"{self._files[number]}: cannot be read ({error.strerror})") from error
        return RawFrame(self._clock.now_ns(), data, None, due_ns, number)


class VideoStream(RecordedStream):
    """Plays a video file; FFV1 in AVI or MKV is lossless, most others are not.

    A video of variable rate is played at the times of its container, faster or slower by the ratio of
    `rate_hz` to its nominal rate.
    """

    def __init__(self, path: Path, rate_hz: float, clock: Clock) -> None:
        super().__init__(path, rate_hz, clock)
        self._capture = cv2.VideoCapture(str(path))
        nominal_hz = self._capture.get(cv2.CAP_PROP_FPS)
        self._nominal_hz = nominal_hz if nominal_hz > 0.0 else rate_hz
        self._first_s, self._last_s = 0.0, 0.0

    def read(self) -> RawFrame:
        there, bgr = self._capture.read()
        if not there:
            raise self._end_error()
        number, due_ns = self._await_next(self._shown_s())
        image = np.ascontiguousarray(bgr[..., ::-1], np.uint8)
        return RawFrame(self._clock.now_ns(), None, image, due_ns, number)

    def close(self) -> None:
        self._capture.release()

    def _shown_s(self) -> float:
        """Return when the newest image is due, s since the first: by the container, or by the frame rate."""
        at_s = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        self._first_s = self._first_s if self._number else at_s
        shown_s, even_s = at_s - self._first_s, self._number / self._nominal_hz
        is_even = at_s <= 0.0 or abs(shown_s - even_s) <= 0.5 / self._nominal_hz
        self._last_s = max(self._last_s, even_s if is_even else shown_s)
        return self._last_s * self._nominal_hz / self._rate_hz


def image_files(folder: Path) -> list[Path]:
    """Return a folder's images in order, without `background.*`, the frame without contact of a clip.

    Raises `InputError` without any, and for one of several pictures.
    """
    try:
        images = images_in_order(folder.iterdir(), PLAYED_SUFFIXES)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}); check its permissions") from error
    files = [file for file in images if file.stem != "background"]
    if images and not files:
        raise InputError(f"{folder}: {images[0].name} is its only image; give the video of the clip")
    if not files:
        raise InputError(f"{folder}: no images in it ({', '.join(PLAYED_SUFFIXES)}); check the path")
    for file in files:
        require_single(file)
    return files


def check_video(path: Path) -> None:
    """Raise `InputError` if a file is not a readable video."""
    capture = cv2.VideoCapture(str(path))
    try:
        check_video_size(capture, path)
        readable = capture.grab()
    finally:
        capture.release()
    if not readable:
        raise InputError(f"{path}: not a readable video; give a device, URL, folder or video file")
