"""A film of one lift: both fingertips, the camera and the growing angle curve side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.types import Image
from protocols.reaction import ReactionKind
from rig.pages.palette import ESTIMATE, INK, MUTED, PAPER, PHASE, TRUTH
from rig.report.curve_panel import CurvePanel, draw_panel
from rig.report.curves import LiftCurves
from rig.report.film_file import Film, require_film_name, save_film
from rig.report.lift_chart import shown_range
from rig.report.session import Lift
from rig.report.strips import TipFrames, angles_at, caption, drawn, read_tip, rgb
from rig.report.unfinished import UnfinishedLift
from rig.results.metrics import Floats
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_frames

HEIGHT_PX, BAND_PX, GAP_PX = 360, 36, 8
CURVE_WIDTH_PX = 560
DEFAULT_FPS = 30.0
LEGEND_PX = 30
_TEXT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What is filmed. tips: fingertips with their frames' times; camera: small pictures with theirs."""

    title: str
    curves: LiftCurves
    tips: tuple[tuple[TipFrames, Floats], ...]
    camera: tuple[list[Image], Floats]
    panel: CurvePanel


@dataclass(frozen=True, slots=True, eq=False)
class FilmedLift:
    """A lift of a session's folder, or the recorded part of an interrupted one."""

    folder: Path
    manifest: TrialManifest
    lift: Lift | UnfinishedLift


def write_film(
    lifts: Sequence[FilmedLift],
    out: Path,
    fps: float = DEFAULT_FPS,
    speed: float = 1.0,
    width_px: int | None = None,
) -> Film:
    """Render a lift, or several one below the other, from the moment their arms rise.

    fps: of the film; speed: 1 as it happened, 0.25 four times slower; width_px: of the film, as drawn
    without it. Raises `InputError` for an ending that no codec is known
    for, `SessionError` for a recording that cannot be read, `RecordingError` when the film cannot be written.
    """
    require_film_name(out)
    pictures = _pictures([_read(each) for each in lifts], speed / fps)
    return save_film(out, (_of_width(picture, width_px) for picture in pictures), fps)


def _read(filmed: FilmedLift) -> _Scene:
    folder, manifest, lift = filmed.folder, filmed.manifest, filmed.lift
    if lift.curves is None:
        raise SessionError(f"{folder / lift.recording}: the recording cannot be read; choose another --lift")
    path = folder / lift.recording
    zero_ns = lift.zero_ns
    tips = []
    for serial, sign in manifest.signs.items():
        tip = read_tip(path, lift.curves, zero_ns, serial, sign)
        tips.append((tip, np.array([(f.time_ns - zero_ns) / NS_PER_S for f in tip.frames])))
    camera: list[Image] = []
    times: list[float] = []
    for serial in (s for s in manifest.serials if s not in manifest.signs):
        for frame in recorded_frames(path, serial, gaps=[]):
            camera.append(_scaled(frame.image))
            times.append((frame.time_ns - zero_ns) / NS_PER_S)
    mark = "SIMULATED, " if manifest.simulated else ""
    panel = draw_panel(lift.curves, CURVE_WIDTH_PX, HEIGHT_PX)
    reaction = "" if manifest.react is ReactionKind.NONE else f", on a slip: {manifest.react}"
    return _Scene(f"{mark}{lift.name}{reaction}", lift.curves, tuple(tips), (camera, np.array(times)), panel)


def _pictures(scenes: Sequence[_Scene], step_s: float) -> Iterator[Image]:
    starts, ends = zip(*(shown_range(scene.curves) for scene in scenes), strict=True)
    for time_s in np.arange(min(starts), max(ends), step_s):
        rows = [_picture(scene, float(time_s)) for scene in scenes]
        width = max(row.shape[1] for row in rows)
        yield _even(np.concatenate([*(_widened(row, width) for row in rows), _legend(width)]))


def _widened(picture: Image, width: int) -> Image:
    missing = np.full((picture.shape[0], width - picture.shape[1], 3), rgb(PAPER.light), np.uint8)
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
    for tip, times in scene.tips:
        image = tip.frames[_at(times, time_s)].image
        panels.append(
            _labelled(_scaled(drawn(image, tip, *angles_at(scene.curves, tip.serial, time_s))), tip.serial)
        )
    images, times = scene.camera
    panels.append(_labelled(images[_at(times, time_s)], "camera") if images else _empty("no camera frames"))
    panels.append(scene.panel.until(time_s))
    gap = np.full((HEIGHT_PX, GAP_PX, 3), rgb(PAPER.light), np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    return np.concatenate([row, _band(scene, time_s, row.shape[1])])


def _band(scene: _Scene, time_s: float, width: int) -> Image:
    """The line below: which lift, which phase, both angles."""
    band = np.full((BAND_PX, width, 3), rgb(PAPER.light), np.uint8)
    begun = [(t, name) for name, t in scene.curves.phases_s.items() if t <= time_s]
    phase = max(begun)[1] if begun else ""
    angles = caption(time_s, *angles_at(scene.curves, "", time_s)).replace("°", " deg")
    text = f"{scene.title}   phase {phase}   {angles}"
    cv2.putText(band, text, (10, BAND_PX - 12), _TEXT, 0.6, rgb(INK.light), 1, cv2.LINE_AA)
    return band


@cache
def _legend(width: int) -> Image:
    """What the colours and lines mean, (LEGEND_PX, width, 3) uint8."""
    band = np.full((LEGEND_PX, width, 3), rgb(PAPER.light), np.uint8)
    middle, x = LEGEND_PX // 2, 10
    for colour, thick, text in (
        (ESTIMATE, 2, "estimated angle, thin axis"),
        (TRUTH, 5, "marker angle, thick axis"),
        (PHASE, 12, "phase B: the arm lifts"),
        (MUTED, 1, "white in the fingertips: outline of the contact"),
    ):
        cv2.line(band, (x, middle), (x + 26, middle), rgb(colour.light), thick, cv2.LINE_AA)
        cv2.putText(band, text, (x + 34, middle + 5), _TEXT, 0.5, rgb(INK.light), 1, cv2.LINE_AA)
        x += 34 + cv2.getTextSize(text, _TEXT, 0.5, 1)[0][0] + 28
    return band


def _at(times: Floats, time_s: float) -> int:
    """Which frame is the newest at a time."""
    return max(int(np.searchsorted(times, time_s, side="right")) - 1, 0)


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
    """Without an odd last row and column, which most codecs refuse."""
    height, width = picture.shape[:2]
    return np.ascontiguousarray(picture[: height // 2 * 2, : width // 2 * 2])
