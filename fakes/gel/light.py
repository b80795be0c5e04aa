"""The illumination of one simulated DIGIT by three coloured LEDs around the gel.

It was fitted to real frames of one unit, by eye and to measured grey levels: red glow with streaks from the
left, blue and dark at the top, green on the right. In those frames a slope brightens in a colour if it faces
away from that colour's LED. Therefore the lower edge of a contact is blue, the upper edge red and yellow, and
the left edge green. A dent casts shadows around it and behind it.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fakes.gel.pad import GelPad, pixel_grid_mm
from fakes.gel.variation import Variation

Planes = NDArray[np.floating]

_LED_AZIMUTH_DEG = (205.0, -28.0, 92.0)
"""Directions of the red, green and blue LED, counter-clockwise from the image's right."""
_LED_DISTANCE_MM = 17.0
_BASE_GAIN = (74.0, 14.0, 64.0)
_GAIN_PER_GLOW = (0.58, 0.30, 0.70)
_WHITE = 248.0
"""Grey level that the brightest glow approaches, as in a camera with soft saturation."""
_DRIFT_PERIODS_S = (23.0, 61.0)


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """One unit's illumination.

    background: (H, W, 3) float32 grey levels without contact. towards_x, towards_y: (3, H/2, W/2) float32,
    per colour the direction in which a downhill slope brightens. gain: (3, H/2, W/2), largest brightening in
    grey levels. drift_share, drift_phase: (2, 3), slow drift of each colour.
    """

    background: Planes
    towards_x: Planes
    towards_y: Planes
    gain: Planes
    drift_share: NDArray[np.float64]
    drift_phase: NDArray[np.float64]

    def drift_at(self, time_s: float) -> NDArray[np.float64]:
        """Return the brightness factors of red, green and blue due to drift of LEDs and white balance."""
        waves = np.sin(2.0 * np.pi * time_s / np.array(_DRIFT_PERIODS_S)[:, None] + self.drift_phase)
        return 1.0 + (self.drift_share * waves).sum(axis=0)


def make_light(pad: GelPad, rng: np.random.Generator) -> Light:
    """Make the illumination of one unit; colours, LED positions and streaks differ between units."""
    background = _background(pad.shape, rng)
    glow = cv2.resize(background, (pad.shape[1] // 2, pad.shape[0] // 2), interpolation=cv2.INTER_AREA)
    glow = cv2.blur(glow, (15, 15)).transpose(2, 0, 1)
    towards_x, towards_y = _directions(pad, rng)
    gain = np.array(_BASE_GAIN)[:, None, None] + np.array(_GAIN_PER_GLOW)[:, None, None] * glow
    gain = gain * rng.uniform(0.85, 1.15, (3, 1, 1))
    common, apart = rng.uniform(0.004, 0.009, (2, 1)), rng.uniform(-0.003, 0.003, (2, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 1)) + rng.uniform(-0.5, 0.5, (2, 3))
    gain = np.ascontiguousarray(gain, np.float32)
    return Light(background, towards_x, towards_y, gain, common + apart, phase)


def vary_light(light: Light, light_seed: int | None) -> Light:
    """Return the illumination with other colours, LED directions and background; unchanged for None."""
    if light_seed is None:
        return light
    rng = np.random.default_rng((light_seed, 29))
    turn = np.deg2rad(rng.normal(0.0, 12.0, (3, 1, 1))).astype(np.float32)
    cos, sin = np.cos(turn), np.sin(turn)
    background = _mix(light.background, rng)
    gain = light.gain * rng.uniform(0.35, 1.3) * rng.uniform(0.7, 1.3, (3, 1, 1))
    # in darker regions a slope reflects less light
    columns, rows = light.gain.shape[2], light.gain.shape[1]
    brighter = (background.mean(axis=2) + 5.0) / (light.background.mean(axis=2) + 5.0)
    gain *= cv2.resize(brighter, (columns, rows), interpolation=cv2.INTER_AREA) ** rng.uniform(0.0, 1.0)
    return replace(
        light,
        background=background,
        towards_x=cos * light.towards_x - sin * light.towards_y,
        towards_y=sin * light.towards_x + cos * light.towards_y,
        gain=gain.astype(np.float32),
    )


def _directions(pad: GelPad, rng: np.random.Generator) -> tuple[Planes, Planes]:
    """Return unit vectors from each LED to each pixel; because the LEDs are near, they are not parallel."""
    x_mm, y_mm = pixel_grid_mm(pad.shape, pad.mm_per_px, 2)
    azimuth = np.deg2rad(np.array(_LED_AZIMUTH_DEG) + rng.normal(0.0, 7.0, 3))[:, None, None]
    distance = _LED_DISTANCE_MM * rng.uniform(0.9, 1.2, (3, 1, 1))
    from_x = x_mm[None, None, :] - distance * np.cos(azimuth)
    from_y = y_mm[None, :, None] + distance * np.sin(azimuth)
    length = np.hypot(from_x, from_y)
    return (from_x / length).astype(np.float32), (from_y / length).astype(np.float32)


def _background(shape: tuple[int, int], rng: np.random.Generator) -> Planes:
    rows, columns = shape
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    u, v = (u + 0.5) / columns, (v + 0.5) / rows
    turn = rng.normal(0.0, 0.06)
    u, v = u + turn * (v - 0.5) + rng.normal(0.0, 0.03), v - turn * (u - 0.5) + rng.normal(0.0, 0.025)
    planes = [_red(u, v, rng), _green(u, v, rng), _blue(u, v, rng)]
    image = np.stack(planes, axis=-1) * rng.uniform(0.85, 1.17, 3) * rng.uniform(0.94, 1.08)
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 2.5) * _blemishes(shape, rng)[..., None]
    image = np.maximum(image, 6.0)
    return (image / (1.0 + (image / _WHITE) ** 4) ** 0.25).astype(np.float32)


def _mix(image: Planes, rng: np.random.Generator) -> Planes:
    """Mix the colours of a background, change its contrast, and add smooth bright and dark patches."""
    rows, columns = image.shape[:2]
    mixed = image @ (np.eye(3) + rng.uniform(-0.12, 0.22, (3, 3))).astype(np.float32)
    level = mixed.mean()
    mixed = level * np.maximum(mixed / level, 0.02) ** rng.uniform(0.6, 1.25)
    patches = np.ones((rows, columns, 3), np.float32)
    # patches per colour, and patches common to all colours, because corners of real units are dark
    for cells, spread in (((7, 6, 3), 0.22), ((4, 3, 1), 0.45)):
        coarse = rng.normal(0.0, rng.uniform(0.0, spread), cells).astype(np.float32)
        smooth = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
        patches *= np.exp(smooth).reshape(rows, columns, cells[2])
    return np.clip(mixed * patches * rng.uniform(0.55, 1.15), 5.0, 250.0).astype(np.float32)


def _red(u: Planes, v: Planes, rng: np.random.Generator) -> Planes:
    arch = 0.13 + rng.uniform(0.3, 0.7) * (u - 0.36 + rng.normal(0.0, 0.05)) ** 2
    below = 0.12 + 0.88 * _step(v - arch, 0.045)
    left = 135.0 * _hill(u, v, (0.16, 0.42), (0.27, 0.30))
    corner = 84.0 * _hill(u, v, (-0.08, 0.54), (0.60, 0.52))
    right = rng.uniform(55.0, 95.0) * _hill(u, v, (0.62, 0.26), (0.24, 0.26))
    spot = rng.uniform(10.0, 55.0) * _hill(u, v, (0.72, 0.33), (0.07, 0.06))
    base = 24.0 + 20.0 * _hill(u, v, (0.4, 0.1), (0.5, 0.5))
    return base + below * (left + corner + right) * _rays(u, v, rng) + spot


def _green(u: Planes, v: Planes, rng: np.random.Generator) -> Planes:
    lid = 0.55 + 0.45 * _step(v - 0.22 - 0.06 * (0.9 - u), 0.05)
    right = 72.0 * lid * _hill(u, v, (0.72 + rng.normal(0.0, 0.04), 0.48), (0.37, 0.33))
    beam_edge = u - 0.52 - 0.22 * (v - 0.45) - rng.normal(0.0, 0.03)
    beam = rng.uniform(22.0, 44.0) * _step(beam_edge, 0.06) * _hill(u, v, (0.85, 0.72), (0.32, 0.36))
    return 56.0 + 30.0 * _hill(u, v, (0.1, 0.30), (0.7, 0.60)) + right + beam


def _blue(u: Planes, v: Planes, rng: np.random.Generator) -> Planes:
    top = 52.0 * _hill(u, v, (0.45 + rng.normal(0.0, 0.06), 0.02), (0.50, 0.30))
    patch = 66.0 * _hill(u, v, (0.33 + rng.normal(0.0, 0.03), 0.61), (0.32, 0.22))
    return 45.0 + 42.0 * _hill(u, v, (0.05, 0.42), (0.50, 0.42)) + top + patch


def _rays(u: Planes, v: Planes, rng: np.random.Generator) -> Planes:
    """Return rays that fan out to the left and down, brighter and darker than the glow around them."""
    angle = np.arctan2(v - 0.18, 0.75 * (0.66 - u))
    rays = np.zeros((1, 720), np.float32)
    for width, share in ((4.0, 0.7), (12.0, 1.0)):
        ray = cv2.GaussianBlur(rng.standard_normal((1, 720)).astype(np.float32), (0, 0), width)
        rays += share * ray / ray.std()
    column = ((angle / np.pi + 1.0) * 359.0).astype(np.float32)
    pattern = cv2.remap(rays, column, np.zeros_like(column), cv2.INTER_LINEAR)
    reach = _hill(u, v, (0.14, 0.50), (0.26, 0.32))
    return np.clip(1.0 + rng.uniform(0.14, 0.26) * reach * pattern, 0.4, 1.6)


def _blemishes(shape: tuple[int, int], rng: np.random.Generator) -> Planes:
    """Return a brightness factor with vignetting, dust on the lens and column noise of the sensor."""
    rows, columns = shape
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    radius = np.hypot((u - columns / 2) / columns, (v - rows / 2) / rows)
    factor = (1.0 - 0.22 * radius**2 + rng.normal(0.0, 0.006, (1, columns))).astype(np.float32)
    for _ in range(int(rng.integers(2, 7))):
        x, y = int(rng.integers(5, columns - 5)), int(rng.integers(5, rows - 5))
        cv2.circle(factor, (x, y), int(rng.integers(1, 3)), float(rng.uniform(0.70, 0.9)), -1)
    return np.asarray(cv2.GaussianBlur(factor, (0, 0), 0.9), np.float32)


def _hill(u: Planes, v: Planes, centre: tuple[float, float], width: tuple[float, float]) -> Planes:
    return np.exp(-(((u - centre[0]) / width[0]) ** 2) - ((v - centre[1]) / width[1]) ** 2)


def _step(distance: Planes, softness: float) -> Planes:
    return 0.5 + 0.5 * np.tanh(distance / softness)


def other_make(light: Light, make_seed: int | None) -> Light:
    """Return the illumination of another make of sensor; unchanged for None."""
    if make_seed is None:
        return light
    rng = np.random.default_rng((make_seed, 53))
    order = rng.permutation(3)
    turn = float(rng.integers(4)) * (np.pi / 2.0) + float(rng.normal(0.0, 0.25))
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    x, y = light.towards_x[order], light.towards_y[order]
    towards_x, towards_y = cos * x + sin * y, cos * y - sin * x
    background = _glow(light.background, (towards_x, towards_y), rng)
    gain = light.gain[order] * np.float32(rng.uniform(0.4, 0.85))
    return replace(light, background=background, towards_x=towards_x, towards_y=towards_y, gain=gain)


def _glow(family: Planes, towards: tuple[Planes, Planes], rng: np.random.Generator) -> Planes:
    """Return a glow, bright in the middle and tinted from each LED's side, mixed with the family's one."""
    rows, columns = family.shape[:2]
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    u, v = (u + 0.5) / columns - 0.5, (v + 0.5) / rows - 0.5
    wide = np.exp(-((u / rng.uniform(0.45, 0.9)) ** 2) - (v / rng.uniform(0.45, 0.9)) ** 2)
    level, dark = rng.uniform(70.0, 150.0), rng.uniform(0.25, 0.6)
    planes = []
    for x, y in zip(*towards, strict=True):
        side = u * np.float32(-x.mean()) + v * np.float32(-y.mean())
        planes.append(level * rng.uniform(0.7, 1.2) * (dark + (1.0 - dark) * wide) * (1.0 + 0.7 * side))
    share = np.float32(rng.uniform(0.0, 0.5))
    smooth = cv2.merge([np.asarray(plane, np.float32) for plane in planes])
    mixed = (1.0 - share) * smooth + share * family * np.float32(smooth.mean() / family.mean())
    return np.clip(mixed, 6.0, 245.0).astype(np.float32)


_SHIFT_PX = 5
_MOST_LOST = 0.6
_STREAK_MM = 12.0
"""Distance behind a contact at which a long shadow has faded to 1/e."""

DepthMap = NDArray[np.float32]


def shade(dent: DepthMap, light: Light, variation: Variation, px_mm: float) -> DepthMap:
    """Return the fraction of each colour's light that is lost, (3, h, w) float32, 0 to 0.6.

    dent: (h, w) mm. px_mm: size of its pixels. At the foot of a dent all colours lose light. Behind the dent,
    as seen from an LED, the colour of that LED loses light. Units with streaks also have long shadows in
    rays.
    """
    smooth = np.asarray(cv2.blur(dent, (9, 9)), np.float32)
    rim = np.maximum(smooth - dent, 0.0) * np.float32(variation.rim_per_mm)
    (rows, columns), lost = dent.shape, np.empty((3, *dent.shape), np.float32)
    towards, px = _mean_directions(light), _SHIFT_PX
    padded = cv2.copyMakeBorder(smooth, px, px, px, px, cv2.BORDER_REPLICATE)
    for colour, (x, y) in enumerate(towards):
        top, left = px + round(y * px), px + round(x * px)
        np.subtract(padded[top : top + rows, left : left + columns], dent, out=lost[colour])
    np.maximum(lost, 0.0, out=lost)
    lost *= np.float32(variation.shadow_per_mm)
    lost += rim
    if variation.streak_per_mm > 0.0:
        lost += np.stack([_streaks(smooth, dent, way, variation, px_mm) for way in towards])
    return np.minimum(lost, np.float32(_MOST_LOST), out=lost)


@lru_cache(maxsize=8)
def _mean_directions(light: Light) -> list[tuple[float, float]]:
    ways = zip(light.towards_x, light.towards_y, strict=True)
    return [(float(x.mean()), float(y.mean())) for x, y in ways]


def _streaks(
    smooth: DepthMap, dent: DepthMap, towards: tuple[float, float], variation: Variation, px_mm: float
) -> DepthMap:
    """Return the light of one LED lost behind a dent, in streaks, as real glow is uneven across the beam."""
    behind = np.maximum(_long_shadow(smooth, towards, px_mm) - dent, 0.0)
    rng = np.random.default_rng(variation.light_seed or 0)
    rows, columns = dent.shape
    along = np.arange(columns)[None, :] * -towards[1] + np.arange(rows)[:, None] * towards[0]
    across = (along - along.min()).astype(np.float32)
    wave = np.asarray(cv2.GaussianBlur(rng.standard_normal((1, 400)).astype(np.float32), (0, 0), 3.0))
    pattern = cv2.remap(0.5 + wave / (4.0 * wave.std()), across, np.zeros_like(across), cv2.INTER_LINEAR)
    return np.asarray(np.float32(variation.streak_per_mm) * behind * np.clip(pattern, 0.0, 1.5), np.float32)


def _long_shadow(dent: DepthMap, towards: tuple[float, float], px_mm: float) -> DepthMap:
    """Return the largest depth (mm) between each pixel and its light, (h, w), fading with distance.

    towards: unit vector from the glow to the middle of the gel, x right and y down. In real frames a contact
    darkens the region between it and the glow of a colour, as if the light came from the other side.
    """
    shadow, step_px = dent, 1.0
    while step_px * px_mm < _STREAK_MM:
        shift = np.array([[1.0, 0.0, -towards[0] * step_px], [0.0, 1.0, -towards[1] * step_px]])
        moved = np.asarray(cv2.warpAffine(shadow, shift, dent.shape[::-1]), np.float32)
        shadow = np.maximum(shadow, moved * np.float32(np.exp(-step_px * px_mm / _STREAK_MM)))
        step_px *= 2.0
    return shadow
