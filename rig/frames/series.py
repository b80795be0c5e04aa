"""Series of tactile frames from any source: a folder of images, a single image, a video or an array.

Frames are read one at a time, in order, each with its time. A frame that cannot be read stays in the series
without an image; the caller decides how to report it.
"""

import filecmp
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import InputError, plural
from drivers.images import (
    SUFFIXES,
    check_video_size,
    image_flaw,
    images_in_order,
    load_image,
    read_image,
    require_single,
)
from drivers.types import Image
from rig.frames.clips import (
    ARRAY_SUFFIXES,
    BACKGROUND,
    FRAMES,
    TIMES,
    TRIAL_VIDEO,
    VIDEO_ENDINGS,
    array_frames,
    array_shape,
    clip_background,
    clip_frames,
    is_raw_video,
    is_ros_bag,
    is_simulated_clip,
    is_trial,
    require_clip,
    trial_background,
)
from rig.frames.ros_bags import bag_images, bag_times, find_topic, rest_of_bag
from rig.frames.times import (
    FrameTime,
    check_times,
    clip_times,
    container_times,
    replace_times,
    stamped_times,
    times_at_rate,
    times_from_table,
    times_in_names,
)
from rig.sessions.recorder import seconds_text
from rig.tactile.contact.background import MAX_FRAMES, auto_background, mean_background
from rig.tactile.contact.untouched import untouched_frames

FOLDER_FPS = 60.0
NO_TIMES = "the file is a raw stream without times: give --fps if they were taken at another rate"
RATE_ASSUMED = f"times: {FOLDER_FPS:g} frames per second assumed, as neither a rate nor a table is given"
TRIAL_NOTE = (
    "background: mean of the pixels outside contact_masks.npy; pixels always in contact are filled in"
)
OTHER_ENDINGS = {".mcap", ".db3", ".bag", *ARRAY_SUFFIXES, *VIDEO_ENDINGS}
# Least number of frames from which a background can be made if contacts move about.
ENOUGH_FRAMES = 9
COMPARED, ALTERNATING, LEAST_OTHER = 8, 3.0, 0.01
"""Frames are of two sensors if of the first COMPARED each differs from the next by more than ALTERNATING
times what any differs from the second next, and by LEAST_OTHER of the brightness. Least over most is at most
1.7 in real_turns and marker_slip_clips, and 15 for two simulated fingertips, which differ by 0.06."""
_COPY = re.compile(r"(?: - Copy| copy| \(copy\))?(?: \(?[0-9]+\)?)?$")
"""End of the name of a copy on Windows, macOS and GNOME, as in `0010 - Copy (2)` and `0010 (1)`."""
_SIDES = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class TimedFrame:
    """A frame with its time. image: (H, W, 3) uint8 RGB, None if it could not be read."""

    name: str
    time: FrameTime
    image: Image | None

    @property
    def time_ns(self) -> int:
        return self.time.time_ns


Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, eq=False)
class FrameSeries:
    """Frames in order; iterating reads them again each time.

    notes: assumptions and problems, for the user. empty: returns the frame without contact, if the dataset
    provides it. simulated: whether a simulated sensor made them. times: of the frames, if they are known
    without reading them.
    """

    name: str
    read: Callable[[], Iterator[TimedFrame]]
    notes: tuple[str, ...] = ()
    empty: Callable[[], Image | None] | None = None
    simulated: bool = False
    times: Sequence[FrameTime] | None = None

    @property
    def count(self) -> int | None:
        return None if self.times is None else len(self.times)

    @property
    def rate_hz(self) -> float:
        """The usual frame rate, that of the median step; `FOLDER_FPS` if there is none."""
        steps_ns = np.diff([time.time_ns for time in self.times or ()])
        return float(NS_PER_S / np.median(steps_ns)) if np.any(steps_ns > 0) else FOLDER_FPS

    def __iter__(self) -> Iterator[TimedFrame]:
        """Read the frames. Raises `InputError` at the first one of another size, and for two sensors."""
        shape: tuple[int, ...] | None = None
        begin = list[TimedFrame]()
        for frame in self.read():
            if frame.image is not None:
                if len(begin) < COMPARED:
                    begin.append(frame)
                    _require_one_sensor(self.name, begin)
                shape = shape or frame.image.shape
                if frame.image.shape != shape:
                    seen, first = size_text(frame.image.shape), size_text(shape)
                    raise InputError(
                        f"{self.name}: '{frame.name}' is {seen}, the first {first}: keep one size"
                    )
            yield frame

    def images(self) -> Iterator[Image]:
        return (frame.image for frame in self if frame.image is not None)


def read_frames(
    path: Path, timestamps: Path | None = None, fps: float | None = None, topic: str | None = None
) -> FrameSeries:
    """Open a clip of one sensor.

    path: a folder of images (sorted by name, numbers by value), an image, a video, an array
    (`rig.frames.clips`), a ROS bag (`rig.frames.ros_bags`), or a trial of TactileTracking
    (`rig.frames.clips`). A folder that contains a folder `frames`, as `rig live` records it, or a video and
    no image but `background.*` is a clip with background and times. timestamps: CSV with `frame,t_s`, see
    `times_from_table`. fps: frame rate in Hz; by default that of the video, or 60 for images. topic: of a ROS
    bag; by default its only image topic.
    Raises `InputError` for anything else.
    """
    if (path / FRAMES).is_dir() or _has_only_a_background(path):
        if timestamps is None and fps is None and (path / TIMES).exists():
            timestamps = path / TIMES
        series, background = read_frames(clip_frames(path), timestamps, fps, topic), clip_background(path)
        empty = series.empty if background is None else partial(read_image, background)
        return replace(series, name=str(path), empty=empty)
    if is_ros_bag(path):
        if timestamps is not None or fps is not None:
            raise InputError(f"{path}: a ROS bag contains its times: leave --timestamps and --fps out")
        return _ros_series(path, find_topic(path, topic))
    if topic is not None:
        raise InputError(f"{path}: is not a ROS bag: leave --topic out")
    if timestamps is not None and fps is not None:
        raise InputError("both --timestamps and --fps set the times of the frames: give one of them")
    if is_trial(path):
        video = _video_series(path / TRIAL_VIDEO, timestamps, fps)
        return replace(
            video, notes=(*video.notes, TRIAL_NOTE), empty=lambda: trial_background(path, video.images())
        )
    require_clip(path)
    if path.is_dir() or path.suffix.lower() in SUFFIXES:
        return _image_series(path, timestamps, fps)
    if path.suffix.lower() in ARRAY_SUFFIXES:
        return _array_series(path, timestamps, fps)
    return _video_series(path, timestamps, fps)


def make_background(spec: str | None, series: FrameSeries) -> tuple[Image, str]:
    """Return the frame without contact, (H, W, 3) uint8 RGB, and a note on its origin.

    spec: the path of an image; `first:N` for the mean of the first N frames; `auto` for one computed from all
    frames, if contacts move about. None: the background of the dataset if it has one, otherwise computed from
    the frames that show the untouched gel, see `find_background`. Raises `InputError`.
    """
    first = next(series.images(), None)
    if first is None:
        raise InputError(f"{series.name}: no frame can be read: copy it again")
    if spec is None and series.empty is not None and (empty := series.empty()) is not None:
        return empty, "background: the set's own"
    if spec is None:
        return find_background(series.name, series.images(), evenly_spread(series.images()))
    if spec == "auto":
        return auto_background(evenly_spread(series.images())), "background: made from all frames (auto)"
    if spec.startswith("first:"):
        number = spec.removeprefix("first:")
        count = int(number) if number.isdecimal() and len(number) < 7 else 0
        if count < 1:
            raise InputError(
                f"--background {spec}: give the number of frames without contact, as in first:10"
            )
        images = list(islice(series.images(), count))
        if len(images) < count:
            raise InputError(
                f"--background {spec}: only {plural(len(images), 'frame')} can be read: give fewer"
            )
        return mean_background(images), f"background: mean of the first {plural(count, 'frame')}"
    background = read_image(Path(spec))
    if background.shape != first.shape:
        seen, wanted = size_text(background.shape), size_text(first.shape)
        raise InputError(f"{spec}: the background is {seen}, the frames are {wanted}: use one size")
    return background, f"background: {spec}"


def size_text(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} px"


def find_background(name: str, images: Iterable[Image], spread: Sequence[Image]) -> tuple[Image, str]:
    """Find the frames of the untouched gel; return their mean and a note.

    These are the first frames if they are alike and later ones differ. Otherwise they are the largest group
    of frames that are alike. images: all frames in order. spread: frames evenly spread over them. Raises
    `InputError` if neither shows an untouched gel.
    """
    frames, first = untouched_frames(images, spread)
    if frames and first:
        note = f"background: mean of the first {plural(len(frames), 'frame')}, which are alike"
        return mean_background(frames), note
    if frames:
        share = f"{len(frames)} of {len(spread)} frames, evenly spread"
        return mean_background(frames), f"background: mean of the {share}, that are most alike"
    raise InputError(
        f"{name}: neither the first frames nor the most frequent ones show an untouched gel: give "
        "--background IMAGE (a frame without contact) or first:N, or auto if contacts move about"
    )


def _require_one_sensor(name: str, first: Sequence[TimedFrame]) -> None:
    """Raise `InputError` if the first frames, `COMPARED` of them, alternate between two pictures."""
    if len(first) < COMPARED:
        return
    small = [
        cv2.resize(f.image, (16, 16), interpolation=cv2.INTER_AREA) for f in first if f.image is not None
    ]
    lit = [image / np.maximum(image.mean(axis=(0, 1)), 1.0) for image in small]
    next_off, second_off = (
        [float(np.abs(one - other).mean()) for one, other in zip(lit, lit[by:], strict=False)]
        for by in (1, 2)
    )
    if min(next_off) > max(ALTERNATING * max(second_off), LEAST_OTHER):
        raise InputError(
            f"{name}: frames '{first[0].name}' and '{first[1].name}' are of two sensors: give those of one"
        )


def evenly_spread(items: Iterable[Item], least: int = MAX_FRAMES) -> list[Item]:
    """Return evenly spread items of a series of unknown length, `least` to twice as many of a long one."""
    kept: list[Item] = []
    step = 1
    for index, item in enumerate(items):
        if index % step == 0:
            kept.append(item)
        if len(kept) > 2 * least:
            kept, step = kept[::2], 2 * step
    return kept


def _has_only_a_background(path: Path) -> bool:
    """Whether a folder's only image is the frame without contact of a clip, whose frames are in a video."""
    with suppress(OSError):  # no folder, or one that cannot be read
        return {file.stem for file in images_in_order(path.iterdir())} == {BACKGROUND} and not is_ros_bag(
            path
        )
    return False


def _image_series(path: Path, timestamps: Path | None, fps: float | None) -> FrameSeries:
    files = _image_files(path) if path.is_dir() else [path]
    background = clip_background(path) if path.is_dir() else None
    files, notes = _without_copies([file for file in files if file != background])
    for file in files:
        require_single(file)
    if not any(load_image(file) is not None for file in files):
        why = image_flaw(files[0]) or "is damaged"
        raise InputError(f"{path}: not one complete image ({files[0].name} {why}): copy it again")
    times, more = _times([file.name for file in files], timestamps, fps)
    simulated = is_simulated_clip(path)

    def read() -> Iterator[TimedFrame]:
        return (TimedFrame(f.name, t, load_image(f)) for f, t in zip(files, times, strict=True))

    notes = (*(["SIMULATED frames"] if simulated else []), *notes, *more)
    empty = None if background is None else partial(read_image, background)
    if background is not None:
        notes = (*notes, f"{background.name}: the background, not a frame")
    return FrameSeries(str(path), read, notes, empty, simulated, times)


def _image_files(folder: Path) -> list[Path]:
    try:
        inside = list(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}): check its permissions") from error
    files = images_in_order(inside)
    if not files:
        others = [f for f in inside if f.suffix.lower() in OTHER_ENDINGS]
        cure = f"give one of its files, as {min(others)}" if others else "check the path"
        raise InputError(f"{folder}: no images in it ({', '.join(SUFFIXES)}): {cure}")
    for before, file in pairwise(sorted(files)):
        if before.stem == file.stem:
            raise InputError(
                f"{folder}: {before.name} and {file.name}: keep one image of a frame in the folder"
            )
    sides = {side.lower(): file.name for file in files for side in _SIDES.findall(file.stem)}
    if len(sides) > 1:
        raise InputError(
            f"{folder}: '{sides['left']}' and '{sides['right']}' are of two sensors: give those of one"
        )
    return files


def _without_copies(files: list[Path]) -> tuple[list[Path], list[str]]:
    """Return images without those that are a copy of another one by name and content, and notes.

    Other images that are equal to the one before stay, because tables and labels count them.
    """
    stems = {file.stem: file for file in files}
    kept, copies, equal = list[Path](), list[Path](), list[Path]()
    for file in files:
        original = stems.get(_COPY.sub("", file.stem), file)
        if original is not file and _is_equal(original, file):
            copies.append(file)
            continue
        if kept and _is_equal(kept[-1], file):
            equal.append(file)
        kept.append(file)
    notes = [f"{plural(len(copies), 'copied image')} left out, as '{copies[0].name}'"] if copies else []
    if equal:
        notes.append(
            f"{plural(len(equal), 'image')} equal to the image before, byte for byte, as '{equal[0].name}'"
        )
    return kept, notes


def _is_equal(one: Path, other: Path) -> bool:
    """Whether two files have the same bytes; False if one cannot be read."""
    with suppress(OSError):
        return one.stat().st_size == other.stat().st_size and filecmp.cmp(one, other, shallow=False)
    return False


def _video_series(path: Path, timestamps: Path | None, fps: float | None) -> FrameSeries:
    shown_ns, announced, rate = _video_facts(path)
    count = len(shown_ns)
    if timestamps is None and fps is None:
        times, notes = container_times(str(path), shown_ns, rate)
        if is_raw_video(path):
            notes = (f"times: {rate:g} frames per second assumed, as {NO_TIMES}",)
    else:
        times, notes = _times([str(i) for i in range(count)], timestamps, fps)
    # OpenCV computes the announced number from duration and rate, so it is too high for a variable rate.
    longest_ns = int(np.diff(shown_ns, prepend=shown_ns[0]).max())
    missing = announced - 0.5 - rate * (shown_ns[-1] + longest_ns) / NS_PER_S
    if announced > count and missing > 0.0:
        cut = f"{path}: {plural(announced, 'frame')} announced, {count} can be read"
        notes = (f"{cut}: is the file complete?", *notes)

    def read() -> Iterator[TimedFrame]:
        capture = cv2.VideoCapture(str(path))
        try:
            for index, time in enumerate(times):
                found, image = capture.read()
                if not found:
                    return
                yield TimedFrame(
                    str(index), time, np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
                )
        finally:
            capture.release()

    return FrameSeries(str(path), read, notes, times=times)


def _array_series(path: Path, timestamps: Path | None, fps: float | None) -> FrameSeries:
    count, height, width = array_shape(path)
    names = [str(number) for number in range(count)]
    times, notes = _times(names, timestamps, fps)

    def read() -> Iterator[TimedFrame]:
        return (TimedFrame(n, t, f) for n, t, f in zip(names, times, array_frames(path), strict=True))

    note = f"{path}: {plural(count, 'frame')} of {width} x {height} px, assumed to be RGB"
    return FrameSeries(str(path), read, (note, *notes), times=times)


def _ros_series(path: Path, topic: str) -> FrameSeries:
    times, notes = stamped_times(f"{path}: {topic}", *bag_times(path, topic))
    order = np.argsort(times, kind="stable")
    sorted_times = [FrameTime(seconds_text(time_ns), time_ns) for time_ns in times[order].tolist()]

    def read() -> Iterator[TimedFrame]:
        images = _in_order(bag_images(path, topic), order)
        for number, (image, time) in enumerate(zip(images, sorted_times, strict=False)):
            yield TimedFrame(str(number), time, image)

    if others := rest_of_bag(path):
        rest = f"{plural(len(others), 'more file')} ({', '.join(file.name for file in others[:3])})"
        notes = [
            *notes,
            f"{path}: is one file of a bag with {rest}: give the folder to read all",
        ]
    return FrameSeries(str(path), read, (f"{path}: {topic}", *notes), times=sorted_times)


def _in_order(images: Iterable[Image | None], order: NDArray[np.intp]) -> Iterator[Image | None]:
    """Yield images in an order of their places; those that come too early are held back."""
    ranks, waiting, rank = np.argsort(order), dict[int, Image | None](), 0
    for image, place in zip(images, ranks.tolist(), strict=False):
        waiting[place] = image
        while rank in waiting:
            yield waiting.pop(rank)
            rank += 1


def _times(
    names: list[str], table: Path | None, fps: float | None
) -> tuple[list[FrameTime], tuple[str, ...]]:
    """Return the times of frames, and notes on those of a table; a clip's own table may be incomplete."""
    if table is None and fps is None:
        assumed = (RATE_ASSUMED,) if len(names) > 1 else ()
        times, note = times_in_names(names) or (times_at_rate(len(names), FOLDER_FPS), "")
        return times, (note,) if note else assumed
    fps = FOLDER_FPS if fps is None else fps
    if table is None:
        return times_at_rate(len(names), fps), ()
    if table.name == TIMES and (table.parent / FRAMES).is_dir():
        times, notes = clip_times(table, names, fps)
    else:
        times, notes = times_from_table(table, names), []
    used, more = check_times(str(table), [time.time_ns for time in times])
    return replace_times(times, used), (*notes, *more)


def _video_facts(path: Path) -> tuple[list[int], int, float]:
    """Return the presentation time of each readable frame, ns, and the header's number of frames and rate."""
    capture = cv2.VideoCapture(str(path))
    try:
        announced, fps = capture.get(cv2.CAP_PROP_FRAME_COUNT), capture.get(cv2.CAP_PROP_FPS)
        check_video_size(capture, path)
        shown_ns = []
        while capture.grab():
            shown_ns.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6))
    finally:
        capture.release()
    if not shown_ns:
        raise InputError(
            f"{path}: neither images nor a video that can be read: give a folder, image or video"
        )
    return shown_ns, max(0, int(min(announced, 1e9))), float(fps)
