"""A picture of the data `slip` works with: features and slopes of two frames of a rotation, the residual."""

import cmath
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.types import Image
from rig.frames.estimates import EstimatedSeries, Estimation
from rig.frames.of_session import of_sensor, session_frames
from rig.frames.series import read_frames
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.tactile.contact.gate import find_contact
from rig.tactile.contact.gel_marks import GelMarks, found_marks
from rig.tactile.contact.relative import RelativeDifference, smooth, work_size
from rig.tactile.estimators import choose_estimator
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.height import Field, Gradient
from rig.tactile.slip.parameters import ALIGNMENT
from rig.tactile.slip.slopes import CURVATURE, slope_planes
from rig.tactile.slip.texture import fine_scale, noise_floor, structure, tensor_of
from rig.tactile.slip.turning import shipped_turning

PANEL_HEIGHT_PX, BAND_PX, GAP_PX = 320, 26, 6
BRIGHTEST = 99.0
"""Percentile of the values that is drawn in full brightness."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Two frames of a series: the one at the zero, and the one with the largest rotation.

    angle_deg (counter-clockwise as seen), shift_px (right, down): motion between them in the image.
    background: the frame without contact. aspect: of a pixel, None if unknown. title: of the picture. notes:
    on the frames, and warnings.
    """

    zero: Image
    later: Image
    apart_s: float
    angle_deg: float
    sigma_deg: float | None
    shift_px: tuple[float, float]
    background: Image
    aspect: float | None
    title: str
    notes: tuple[str, ...]


def explained_frames(
    path: Path, background: str | None, aspect: float | None, topic: str | None = None
) -> Turn:
    """Find the largest rotation in a clip. topic: see `read_frames`. Raises `InputError`."""
    series = read_frames(path, topic=topic)
    found = Estimation(choose_estimator(None, None), background, aspect=aspect).of_series(series)
    return _largest_turn(found, aspect, path.name)


def explained_lift(folder: Path, lift: int, serial: str | None) -> Turn:
    """Find the largest rotation at one fingertip in a lift of a session. Raises `InputError`."""
    tips = [tip for tip in session_frames(folder)[0] if tip.lift.split("-")[0] == f"{lift:03d}"]
    if not tips:
        raise InputError(f"{folder}: no finished lift {lift}; see rig report {folder}")
    tip = of_sensor(tips, serial)[0]
    found = Estimation(choose_estimator(None, None)).of_series(tip)
    manifest = read_manifest_of(folder, TrialManifest, "it has no lifts")
    mark = "SIMULATED, " if manifest.simulated else ""
    return _largest_turn(found, tip.aspect, f"{mark}lift {lift}, {tip.serial}")


def _largest_turn(found: EstimatedSeries, aspect: float | None, title: str) -> Turn:
    """Find the frame with the largest rotation from the zero. Raises `InputError` without any angle."""
    estimate = found.estimate
    answered = [(abs(s.angle_deg), i) for i, s in enumerate(estimate.samples) if s.angle_deg is not None]
    if estimate.zero is None or not answered:
        raise InputError(f"{found.frames.name}: no frame has an angle; give frames with a contact that turns")
    place = max(answered)[1]
    zero_ns, later_ns, sample = estimate.zero.time_ns, estimate.times[place].time_ns, estimate.samples[place]
    wanted = (zero_ns, later_ns)
    images = {f.time_ns: f.image for f in found.frames if f.image is not None and f.time_ns in wanted}
    return Turn(
        images[zero_ns],
        images[later_ns],
        (later_ns - zero_ns) / NS_PER_S,
        found.sign * (sample.angle_deg or 0.0),
        sample.sigma_deg,
        sample.shift_px or (0.0, 0.0),
        found.untouched,
        aspect,
        title,
        (*found.frames.notes, *(f"warning: {warning}" for warning in found.warnings)),
    )


def stages_picture(turn: Turn) -> Image:
    """Draw a rotation, (H, W, 3) uint8 RGB: features, frames, slopes, the same rotated, and the residual.

    Raises `InputError` if the frame at the zero shows no contact from which to learn the slopes.
    """
    background = turn.background
    size = work_size(background.shape, turn.aspect or 1.0)
    first, now = (smooth(_difference(image, background, size)) for image in (turn.zero, turn.later))
    region = find_contact(first)
    learnt = None if region is None else learn_map(first, region.mask)
    if region is None or learnt is None:
        raise InputError(f"{turn.title}: the frame at the zero shows no dent; give another --reference-time")
    slopes, slopes_now = learnt.apply(first), learnt.apply(now)
    turned = _rotate(slopes, region.mask, turn)
    whole = (0, 0, region.mask.shape[1], region.mask.shape[0])
    planes = slope_planes(first, learnt, region.mask, whole, ALIGNMENT.broad_share)
    scale = float(np.percentile(np.abs(slopes), BRIGHTEST))
    rows = (
        (
            (_draw_signed(first), "difference at the zero"),
            (_texture_picture(turn.zero, background, size), "texture, weighted by the network"),
            (_draw_signed(planes[CURVATURE, ..., None]), "curvature"),
        ),
        (
            (turn.zero, "at the zero"),
            (_draw_slopes(slopes, scale), "its slopes"),
            (_draw_slopes(turned, scale), f"the same, turned by {turn.angle_deg:+.1f} deg"),
        ),
        (
            (turn.later, f"{turn.apart_s:.2f} s later"),
            (_draw_slopes(slopes_now, scale), "its slopes"),
            (_draw_slopes(slopes_now - turned, scale), "what the turn does not explain"),
        ),
    )
    return _sheet(rows, turn)


def _difference(image: Image, background: Image, size: tuple[int, int]) -> Field:
    """Return the relative difference from the background, (h, w, 3), as the estimator computes it."""
    light = RelativeDifference(background, size)
    return GelMarks(found_marks(background, size), size).fill(light.of(light.reduce(image)))


def _texture_picture(image: Image, background: Image, size: tuple[int, int]) -> Image:
    """Draw the texture of a frame, (h, w, 3): twice the direction as hue, the strength as brightness."""
    scale = fine_scale(background.shape, size)
    fine = _difference(image, background, (scale * size[0], scale * size[1])).transpose(2, 0, 1)
    tensor = tensor_of(np.ascontiguousarray(fine), _difference(image, background, size), scale)
    counts = shipped_turning().counts(fine, scale)
    planes = structure(tensor, noise_floor(tensor), counts, (0, 0, 0, 0), scale).planes
    return _draw_slopes(planes[0] + 1j * planes[1], float(planes[2].max()))


def _draw_signed(values: Field) -> Image:
    scale = max(float(np.percentile(np.abs(values), BRIGHTEST)), 1e-9)
    levels = (128.0 + 127.0 * np.clip(values / scale, -1.0, 1.0)).astype(np.uint8)
    return np.broadcast_to(levels, (*values.shape[:2], 3))


def _rotate(slopes: Gradient, mask: Image, turn: Turn) -> Gradient:
    """Rotate positions and vectors about the contact's centre and shift them by the estimate."""
    down, across = np.nonzero(mask)
    middle = complex(across.mean(), down.mean())
    height, width = slopes.shape
    full_height, full_width = turn.background.shape[:2]
    shift = complex(turn.shift_px[0] * width / full_width, turn.shift_px[1] * height / full_height)
    # counter-clockwise as seen, with y down
    turning = cmath.exp(-1j * math.radians(turn.angle_deg))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    came_from = (columns + 1j * rows - middle - shift) / turning + middle
    x, y = came_from.real.astype(np.float32), came_from.imag.astype(np.float32)
    parts = [cv2.remap(np.ascontiguousarray(p), x, y, cv2.INTER_LINEAR) for p in (slopes.real, slopes.imag)]
    return np.asarray((parts[0] + 1j * parts[1]) * turning, np.complex64)


def _draw_slopes(slopes: Gradient, scale: float) -> Image:
    """Draw slopes as colours: the direction as hue, the steepness as brightness."""
    hue = (np.degrees(np.angle(slopes)) % 360.0) / 2.0
    value = np.clip(np.abs(slopes) / max(scale, 1e-9), 0.0, 1.0) * 255.0
    hsv = np.stack([hue, np.full_like(hue, 200.0), value], axis=-1).astype(np.uint8)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)


def _sheet(rows: tuple[tuple[tuple[Image, str], ...], ...], turn: Turn) -> Image:
    width = round(PANEL_HEIGHT_PX * turn.background.shape[1] / turn.background.shape[0])
    gap = np.full((PANEL_HEIGHT_PX + BAND_PX, GAP_PX, 3), 255, np.uint8)
    lines = []
    for row in rows:
        panels: list[Image] = []
        for picture, text in row:
            panel = cv2.resize(picture, (width, PANEL_HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
            panels += [np.concatenate([np.asarray(panel, np.uint8), _band(text, width)]), gap]
        lines.append(np.concatenate(panels[:-1], axis=1))
    return np.concatenate([_band(turn.title, lines[0].shape[1]), *lines])


def _band(text: str, width: int) -> Image:
    band = np.full((BAND_PX, width, 3), 255, np.uint8)
    cv2.putText(band, text, (4, BAND_PX - 9), _FONT, 0.42, (30, 30, 30), 1, cv2.LINE_AA)
    return band
