"""A film of a lift or a clip: fingertips and camera, and below them the growing angle curve."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RecordingError, SessionError
from drivers.progress import steps
from drivers.types import Image
from protocols.reaction import ReactionKind
from rig.frames.estimates import EstimatedSeries
from rig.pages.palette import ESTIMATE, INK, MUTED, PAPER, PHASE, TRUTH
from rig.report.charts import CurvePanel, Ranges, common_ranges, draw_panel
from rig.report.own_frames import estimate_lift, tip_of
from rig.report.strips import TipFrames, angles_at, caption, draw_contact, read_tip, rgb
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_frames
from rig.sessions.records import Lift

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
    all_pictures = (cast(Image, cv2.cvtColor(p, cv2.COLOR_RGB2BGR)) for p in chain([first], pictures))
    try:
        if out.suffix.lower() == ANIMATED:
            count, there = _animate(aside, fps, all_pictures), cv2.imcount(str(aside))
        else:
            count, film = _write(aside, codec, fps, size, all_pictures), cv2.VideoCapture(str(aside))
            there = sum(1 for _ in iter(film.grab, False))
            film.release()
        if there < count:  # OpenCV's writer does not report a full disk
            raise RecordingError(f"{out}: {there} of {count} pictures were written as '{codec}'; free space")
        aside.replace(out)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror}); choose another --out") from error
    finally:
        aside.unlink(missing_ok=True)
    return Film(out, count, codec, size)


def _animate(path: Path, fps: float, pictures: Iterable[Image]) -> int:
    frames = list(islice(pictures, MOST_ANIMATED + 1))
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
        for count, picture in enumerate(pictures, start=1):  # noqa: B007 - returned
            writer.write(picture)
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


HEIGHT_PX, CURVE_PX, BAND_PX, LEGEND_PX, GAP_PX = 360, 240, 36, 30, 8
"""Heights of pictures, curve, line of text and line of the legend, and the gap between pictures."""
LEAST_WIDTH_PX = 720
DEFAULT_FPS = 30.0
MOST_PICTURES = 100_000
_TEXT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Content of a film. tips: fingertips with their frames. camera: its frames, None without a camera."""

    title: str
    lift: Lift
    tips: tuple[tuple[TipFrames, "_ImageAt"], ...]
    camera: "_ImageAt | None"
    ranges: Ranges = ((0.0, 0.0), (0.0, 0.0))


_ImageAt = Callable[[float], Image | None]
"""Returns the newest image at a time, s; None if there is no image. Times must not decrease."""


Filmed = tuple[Path, TrialManifest, Lift]
"""A lift with its session's folder and manifest."""


def write_film(
    filmed: Sequence[Filmed | EstimatedSeries],
    out: Path,
    fps: float = DEFAULT_FPS,
    speed: float = 1.0,
    width_px: int | None = None,
) -> Film:
    """Render lifts from phase A on, or all frames of clips; several are shown one below the other.

    fps: frame rate of the film. speed: 1 for real time, 0.25 for four times slower. width_px: of the film;
    None for the original width. An .mp4 becomes a .webm if OpenCV has no H.264, see `film_place`. Raises
    `InputError` for an ending without a codec, `SessionError` for a recording that cannot be read,
    `RecordingError` if the film cannot be written.
    """
    out = film_place(out)
    scenes = [_scene(each) for each in filmed]
    ranges = common_ranges([scene.lift for scene in scenes])
    scenes = [replace(scene, ranges=ranges) for scene in scenes]
    return save_film(out, _pictures(scenes, speed / fps, width_px), fps)


def _scene(of: Filmed | EstimatedSeries) -> _Scene:
    """Return a clip, or a lift. Raises `SessionError` for a recording that cannot be read."""
    if isinstance(of, EstimatedSeries):
        images = ((f.time.time_ns / NS_PER_S, f.image) for f in of.frames if f.image is not None)
        return _Scene(of.name, estimate_lift(of), ((tip_of(of), _newest(images)),), None)
    folder, manifest, lift = of
    if not lift.angles:
        raise SessionError(f"{folder / lift.recording}: the recording cannot be read; choose another --lift")
    path, zero_ns, signs = folder / lift.recording, lift.zero_ns, manifest.signs
    tips = []
    for serial, sign in signs.items():
        tip = read_tip(path, lift, serial, sign)
        tips.append((tip, _newest(((f.time_ns - zero_ns) / NS_PER_S, f.image) for f in tip.frames)))
    cameras = [serial for serial in manifest.serials if serial not in signs]
    seen = (frame for serial in cameras for frame in recorded_frames(path, serial, gaps=[]))
    camera = (((frame.time_ns - zero_ns) / NS_PER_S, _scale(frame.image)) for frame in seen)
    mark = "SIMULATED, " if manifest.simulated else ""
    reaction = "" if manifest.react is ReactionKind.NONE else f", on a slip: {manifest.react}"
    return _Scene(f"{mark}{lift.title}{reaction}", lift, tuple(tips), _newest(camera))


def _newest(frames: Iterable[tuple[float, Image]]) -> _ImageAt:
    """Return a function that returns the newest frame at a time. frames: (s, image), read one by one."""
    ahead = iter(frames)
    shown = following = next(ahead, None)

    def newest(time_s: float) -> Image | None:
        nonlocal shown, following
        while following is not None and following[0] <= time_s:
            shown, following = following, next(ahead, None)
        return None if shown is None else shown[1]

    return newest


def _pictures(scenes: Sequence[_Scene], step_s: float, width_px: int | None) -> Iterator[Image]:
    start_s, end_s = scenes[0].ranges[0]
    if end_s - start_s > MOST_PICTURES * step_s:
        raise InputError(f"the film would have more than {MOST_PICTURES} pictures: give a higher --speed")
    for time_s in steps(np.arange(start_s, end_s, step_s)):
        rows = [_picture(scene, float(time_s)) for scene in scenes]
        width = max(row.shape[1] for row in rows)
        legend = _legend(width, any(scene.lift.phases_s for scene in scenes))
        picture = np.concatenate([*(_widen(row, width) for row in rows), legend])
        # most codecs reject an odd last row and column
        picture = picture[: picture.shape[0] // 2 * 2, : width // 2 * 2]
        if width_px is not None:
            height_px = round(picture.shape[0] * width_px / picture.shape[1])
            picture = _resize(picture, width_px, height_px)[: height_px // 2 * 2, : width_px // 2 * 2]
        yield np.ascontiguousarray(picture)


@lru_cache(maxsize=8)
def _panel(scene: _Scene, width_px: int) -> CurvePanel:
    return draw_panel(scene.lift, scene.ranges, width_px, CURVE_PX)


def _widen(picture: Image, width: int) -> Image:
    missing = _blank(picture.shape[0], width - picture.shape[1])
    return np.concatenate([picture, missing], axis=1)


def _picture(scene: _Scene, time_s: float) -> Image:
    panels = []
    for tip, image_at in scene.tips:
        image, angles = image_at(time_s), angles_at(scene.lift, tip.serial, time_s)
        picture = _empty("no frames") if image is None else _scale(draw_contact(image, tip, *angles))
        panels.append(_label(picture, tip.serial))
    if scene.camera is not None:
        view = scene.camera(time_s)
        panels.append(_empty("no camera frames") if view is None else _label(view, "camera"))
    gap = _blank(HEIGHT_PX, GAP_PX)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    width = max(row.shape[1], LEAST_WIDTH_PX)
    curve = _panel(scene, width).until(time_s)
    return np.concatenate([_widen(row, width), curve, _band(scene, time_s, width)])


def _band(scene: _Scene, time_s: float, width: int) -> Image:
    """Draw the line of text below: lift, phase and both angles."""
    band = _blank(BAND_PX, width)
    begun = [(t, name) for name, t in scene.lift.begins_s.items() if t <= time_s]
    phase = max(begun)[1] if begun else ""
    estimate, truth = angles_at(scene.lift, "", time_s)
    angles = caption(time_s, estimate, truth if scene.lift.phases_s else None)
    stage = f"   phase {phase}" if scene.lift.phases_s else ""
    text = f"{scene.title}{stage}   {angles.replace('°', ' deg')}"
    size = min(0.6, 0.6 * (width - 20) / cv2.getTextSize(text, _TEXT, 0.6, 1)[0][0])
    cv2.putText(band, text, (10, BAND_PX - 12), _TEXT, size, rgb(INK.light), 1, cv2.LINE_AA)
    return band


@cache
def _legend(width: int, of_a_lift: bool) -> Image:
    """Draw the legend, (N LEGEND_PX, width, 3) uint8. of_a_lift: whether there are markers and phases."""
    lift = ((TRUTH, 5, "marker angle, thick axis"), (PHASE, 12, "phase B: the arm lifts"))
    outline = (MUTED, 1, "white in the fingertips: outline of the contact")
    entries = ((ESTIMATE, 2, "estimated angle, thin axis"), *(lift if of_a_lift else ()), outline)
    lines, x = [_blank(LEGEND_PX, width)], 10
    middle = LEGEND_PX // 2
    for colour, thick, text in entries:
        ends = x + 34 + cv2.getTextSize(text, _TEXT, 0.5, 1)[0][0]
        if ends > width and x > 10:
            lines.append(_blank(LEGEND_PX, width))
            x, ends = 10, ends - x + 10
        cv2.line(lines[-1], (x, middle), (x + 26, middle), rgb(colour.light), thick, cv2.LINE_AA)
        cv2.putText(lines[-1], text, (x + 34, middle + 5), _TEXT, 0.5, rgb(INK.light), 1, cv2.LINE_AA)
        x = ends + 28
    return np.concatenate(lines)


def _blank(height: int, width: int) -> Image:
    return np.full((height, width, 3), rgb(PAPER.light), np.uint8)


def _scale(image: Image) -> Image:
    return _resize(image, round(image.shape[1] * HEIGHT_PX / image.shape[0]), HEIGHT_PX)


def _resize(image: Image, width_px: int, height_px: int) -> Image:
    return np.asarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)


def _label(picture: Image, text: str) -> Image:
    labelled = picture.copy()
    for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(labelled, text, (8, 20), _TEXT, 0.5, colour, thick, cv2.LINE_AA)
    return labelled


def _empty(text: str) -> Image:
    return _label(np.full((HEIGHT_PX, HEIGHT_PX, 3), 128, np.uint8), text)
