"""A film of one lift: both fingertips, the camera and the growing angle curve side by side."""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RecordingError, SessionError
from drivers.types import Image
from rig.pages.palette import ESTIMATE, INK, MUTED, PAPER, PHASE, TRUTH
from rig.report.curve_panel import CurvePanel, draw_panel
from rig.report.curves import LiftCurves
from rig.report.lift_chart import shown_range
from rig.report.session import Lift
from rig.report.strips import TipFrames, angles_at, caption, drawn, read_tip, rgb
from rig.results.metrics import Floats
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_frames

HEIGHT_PX, BAND_PX, GAP_PX = 360, 36, 8
CURVE_WIDTH_PX = 560
DEFAULT_FPS = 30.0
LEGEND_PX = 30
CODECS = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
"""Codecs that every build of OpenCV writes, by the file's ending. Browsers play the first."""
_TEXT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Film:
    """A film that was written. codec: the four letters OpenCV knows it by."""

    path: Path
    frames: int
    codec: str
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What is filmed. tips: fingertips with their frames' times; camera: small pictures with theirs."""

    title: str
    curves: LiftCurves
    tips: tuple[tuple[TipFrames, Floats], ...]
    camera: tuple[list[Image], Floats]
    panel: CurvePanel


def write_film(
    folder: Path,
    manifest: TrialManifest,
    lift: Lift,
    out: Path,
    fps: float = DEFAULT_FPS,
    speed: float = 1.0,
) -> Film:
    """Render a lift. fps: of the film; speed: 1 as it happened, 0.25 four times slower.

    Raises `InputError` for an ending that no codec is known for, `SessionError` for a recording
    that cannot be read, `RecordingError` when the film cannot be written.
    """
    require_film_name(out)
    return save_film(out, _pictures(_read(folder, manifest, lift), speed / fps), fps)


def require_film_name(out: Path) -> None:
    """Raise `InputError` for an ending that no codec is known for, or a folder that is not there."""
    if out.suffix.lower() not in CODECS:
        raise InputError(f"{out}: a film's name ends in {' or '.join(CODECS)}")
    if not out.parent.is_dir():
        raise InputError(f"{out.parent}: no such folder; make it, or choose another --out")


def save_film(out: Path, pictures: Iterator[Image], fps: float) -> Film:
    """Write pictures of one size (height x width x 3, RGB) as a film, whole or not at all.

    Raises `RecordingError` when it cannot be written.
    """
    first = next(pictures)
    codec, size = CODECS[out.suffix.lower()], (first.shape[1], first.shape[0])
    aside = out.with_name(f".{out.stem}-{os.getpid()}{out.suffix}")
    try:
        count = _write(aside, codec, fps, size, chain([first], pictures))
        there = _pictures_in(aside)
        if there < count:  # its writer tells of no full disk
            raise RecordingError(f"{out}: {there} of {count} pictures were written as '{codec}'; free space")
        aside.replace(out)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror}); choose another --out") from error
    finally:
        aside.unlink(missing_ok=True)
    return Film(out, count, codec, size)


def _write(path: Path, codec: str, fps: float, size: tuple[int, int], pictures: Iterable[Image]) -> int:
    path.touch()  # says what is wrong, as the writer does not
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
    """Let OpenCV's libraries say nothing on standard error: that WebM has a tag of its own is no fault."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # there is none
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


def _read(folder: Path, manifest: TrialManifest, lift: Lift) -> _Scene:
    if lift.curves is None:
        raise SessionError(
            f"{folder / lift.row.recording}: the recording cannot be read; choose another --lift"
        )
    path = folder / lift.row.recording
    zero_ns = lift.zero_ns
    tips = []
    for serial, sign in manifest.signs.items():
        tip = read_tip(path, lift.curves, zero_ns, serial, sign)
        tips.append((tip, np.array([(f.time_ns - zero_ns) / NS_PER_S for f in tip.frames])))
    camera: list[Image] = []
    times: list[float] = []
    for serial in (s for s in manifest.serials if s not in manifest.signs):
        for frame in recorded_frames(path, serial):
            camera.append(_scaled(frame.image))
            times.append((frame.time_ns - zero_ns) / NS_PER_S)
    mark = "SIMULATED, " if manifest.simulated else ""
    panel = draw_panel(lift.curves, CURVE_WIDTH_PX, HEIGHT_PX)
    return _Scene(f"{mark}{lift.name}", lift.curves, tuple(tips), (camera, np.array(times)), panel)


def _pictures(scene: _Scene, step_s: float) -> Iterator[Image]:
    start, end = shown_range(scene.curves)
    for time_s in np.arange(start, end, step_s):
        yield _picture(scene, float(time_s))


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
    return _even(np.concatenate([row, _band(scene, time_s, row.shape[1]), _legend(row.shape[1])]))


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
