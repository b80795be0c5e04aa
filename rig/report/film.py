"""A film of a lift or a clip: fingertips and camera, and below them the growing angle curve."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, SessionError
from drivers.progress import steps
from drivers.types import Image
from protocols.reaction import ReactionKind
from rig.frames.estimates import EstimatedSeries
from rig.pages.palette import ESTIMATE, INK, MUTED, PAPER, PHASE, TRUTH
from rig.report.curve_panel import CurvePanel, draw_panel
from rig.report.film_file import Film, film_place, save_film
from rig.report.lift_chart import on_one_scale, shown_range
from rig.report.own_frames import estimate_curves, tip_of
from rig.report.strips import TipFrames, angles_at, caption, drawn, read_tip, rgb
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_frames
from rig.sessions.records import Lift

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
    curves: LiftCurves
    tips: tuple[tuple[TipFrames, "_ImageAt"], ...]
    camera: "_ImageAt | None"


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
    scenes = [_own_frames(each) if isinstance(each, EstimatedSeries) else _read(*each) for each in filmed]
    shared = on_one_scale([scene.curves for scene in scenes])
    scenes = [replace(scene, curves=curves) for scene, curves in zip(scenes, shared, strict=True)]
    pictures = _pictures(scenes, speed / fps)
    return save_film(out, (_of_width(picture, width_px) for picture in pictures), fps)


def _read(folder: Path, manifest: TrialManifest, lift: Lift) -> _Scene:
    if lift.curves is None:
        raise SessionError(f"{folder / lift.recording}: the recording cannot be read; choose another --lift")
    path = folder / lift.recording
    zero_ns = lift.zero_ns
    tips = []
    for serial, sign in manifest.signs.items():
        tip = read_tip(path, lift.curves, zero_ns, serial, sign)
        tips.append((tip, _newest(((f.time_ns - zero_ns) / NS_PER_S, f.image) for f in tip.frames)))
    camera = (
        ((frame.time_ns - zero_ns) / NS_PER_S, _scaled(frame.image))
        for serial in manifest.serials
        if serial not in manifest.signs
        for frame in recorded_frames(path, serial, gaps=[])
    )
    mark = "SIMULATED, " if manifest.simulated else ""
    reaction = "" if manifest.react is ReactionKind.NONE else f", on a slip: {manifest.react}"
    return _Scene(f"{mark}{lift.title}{reaction}", lift.curves, tuple(tips), _newest(camera))


def _own_frames(series: EstimatedSeries) -> _Scene:
    curves = estimate_curves(series)
    frames = ((f.time.time_ns / NS_PER_S, f.image) for f in series.frames if f.image is not None)
    return _Scene(series.name, curves, ((tip_of(series), _newest(frames)),), None)


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


def _pictures(scenes: Sequence[_Scene], step_s: float) -> Iterator[Image]:
    starts, ends = zip(*(shown_range(scene.curves) for scene in scenes), strict=True)
    if max(ends) - min(starts) > MOST_PICTURES * step_s:
        raise InputError(f"the film would have more than {MOST_PICTURES} pictures: give a higher --speed")
    for time_s in steps(np.arange(min(starts), max(ends), step_s)):
        rows = [_picture(scene, float(time_s)) for scene in scenes]
        width = max(row.shape[1] for row in rows)
        legend = _legend(width, any(scene.curves.phases_s for scene in scenes))
        yield _even(np.concatenate([*(_widened(row, width) for row in rows), legend]))


@lru_cache(maxsize=8)
def _curve(scene: _Scene, width: int) -> CurvePanel:
    return draw_panel(scene.curves, width, CURVE_PX)


def _widened(picture: Image, width: int) -> Image:
    missing = _blank(picture.shape[0], width - picture.shape[1])
    return np.concatenate([picture, missing], axis=1)


def _of_width(picture: Image, width_px: int | None) -> Image:
    if width_px is None:
        return picture
    height_px = round(picture.shape[0] * width_px / picture.shape[1])
    return _even(
        np.asarray(cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)
    )


def _picture(scene: _Scene, time_s: float) -> Image:
    panels = []
    for tip, image_at in scene.tips:
        image, angles = image_at(time_s), angles_at(scene.curves, tip.serial, time_s)
        picture = _empty("no frames") if image is None else _scaled(drawn(image, tip, *angles))
        panels.append(_labelled(picture, tip.serial))
    if scene.camera is not None:
        view = scene.camera(time_s)
        panels.append(_empty("no camera frames") if view is None else _labelled(view, "camera"))
    gap = _blank(HEIGHT_PX, GAP_PX)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    width = max(row.shape[1], LEAST_WIDTH_PX)
    curve = _curve(scene, width).until(time_s)
    return np.concatenate([_widened(row, width), curve, _band(scene, time_s, width)])


def _band(scene: _Scene, time_s: float, width: int) -> Image:
    """Draw the line of text below: lift, phase and both angles."""
    band = _blank(BAND_PX, width)
    begun = [(t, name) for name, t in scene.curves.phases_s.items() if t <= time_s]
    phase = max(begun)[1] if begun else ""
    estimate, truth = angles_at(scene.curves, "", time_s)
    angles = caption(time_s, estimate, truth if scene.curves.phases_s else None)
    stage = f"   phase {phase}" if scene.curves.phases_s else ""
    text = f"{scene.title}{stage}   {angles.replace('°', ' deg')}"
    size = min(0.6, 0.6 * (width - 20) / cv2.getTextSize(text, _TEXT, 0.6, 1)[0][0])
    cv2.putText(band, text, (10, BAND_PX - 12), _TEXT, size, rgb(INK.light), 1, cv2.LINE_AA)
    return band


_OF_A_LIFT = ((TRUTH, 5, "marker angle, thick axis"), (PHASE, 12, "phase B: the arm lifts"))


@cache
def _legend(width: int, of_a_lift: bool) -> Image:
    """Draw the legend, (N LEGEND_PX, width, 3) uint8. of_a_lift: whether there are markers and phases."""
    entries = (
        (ESTIMATE, 2, "estimated angle, thin axis"),
        *(_OF_A_LIFT if of_a_lift else ()),
        (MUTED, 1, "white in the fingertips: outline of the contact"),
    )
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


def _scaled(image: Image) -> Image:
    width = round(image.shape[1] * HEIGHT_PX / image.shape[0])
    return np.asarray(cv2.resize(image, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA), np.uint8)


def _labelled(picture: Image, text: str) -> Image:
    labelled = picture.copy()
    for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(labelled, text, (8, 20), _TEXT, 0.5, colour, thick, cv2.LINE_AA)
    return labelled


def _empty(text: str) -> Image:
    return _labelled(np.full((HEIGHT_PX, HEIGHT_PX, 3), 128, np.uint8), text)


def _even(picture: Image) -> Image:
    """Return the image without an odd last row and column, which most codecs reject."""
    height, width = picture.shape[:2]
    return np.ascontiguousarray(picture[: height // 2 * 2, : width // 2 * 2])
