"""Fit a unit's look to photographs of pressed balls, and check it on presses that were left out.

In its contact the gel has the shape of the ball, and around it the shape of the membrane, so every pixel of a
photograph is a sample of the colour at a known slope. Circles drawn by hand or detected are inexact; position
and radius of each are adjusted together with the model. The parts of the photographs that nothing touches
show background, noise and JPEG compression.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.look import DOME_MM, HALF, SLOPE_TERMS, GelLook, membrane, shadow_terms, slope_terms
from calibration.gel.noise import CameraNoise, measure_noise
from drivers.errors import CalibrationError, plural
from drivers.types import Image

Array = NDArray[np.floating]

Circle = tuple[float, float, float]
"""x, y and radius of a contact, px of the image."""

ENOUGH_FRAMES = 8
"""Number of untouched frames from which the presses are not needed for the background."""
_UNTOUCHED = 2.2
"""Beyond this, in radii of the circle of its contact, a press leaves the gel as it is."""
_LIGHT_PX = 8.0
"""Standard deviation of a blur; broader structure is light, not noise."""
_NOISE_PX = 2.0
"""Standard deviation of a blur that removes most of a camera's noise."""
_MEDIAN_VARIANCE = np.pi / 2.0
"""Variance of the median of N normal values, times N, over their variance."""
_JPEG_QUALITIES = range(50, 97)
_JPEG_DIP = 0.8
"""Compressing a picture again with its own quality changes it by less than this share of the next quality."""
FEWEST = 8
_AROUND = 1.7
"""Pixels nearer than this, in radii of a circle, belong to its press."""
_RIDGE = 3e-3
_ROUNDS = 6
_STEP_PX = 2.0
_PRIOR_GREY = 20.0
"""Weight of the penalty on a step of a circle by 1 px: that of an error of 20 grey levels in one pixel."""
_MOST_STEP_PX = 5.0
Model = tuple[int, bool, bool]
_MODELS: tuple[Model, ...] = (
    (0, False, False),
    (1, False, False),
    (1, True, False),
    (1, False, True),
    (2, True, True),
)
"""Degree of the polynomial in position, whether the background scales the slopes, whether shadows exist."""
_BETTER = 0.97
"""A larger model must lower the held-out error to this share, else the smaller one is kept."""


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """A photograph of a pressed ball, and the circle of its contact."""

    id: str
    image: Image
    circle: Circle
    radius_mm: float


def jpeg_quality(image: Image) -> int | None:
    """Quality of the JPEG compression that a picture shows; None if it shows none.

    A picture that was compressed at a quality hardly changes when it is compressed so again.
    """
    errors = []
    for quality in _JPEG_QUALITIES:
        _, data = cv2.imencode(".jpg", image[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality))
        again = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.float32)
        errors.append(float(np.sqrt(((again - image) ** 2).mean())))
    drop = np.array(errors[1:-1]) / np.maximum(np.minimum(errors[:-2], errors[2:]), 1e-3)
    found = int(np.argmin(drop))
    return _JPEG_QUALITIES[found + 1] if drop[found] < _JPEG_DIP else None


def background_and_noise(
    presses: Sequence[Pressed], background: Image, untouched: Sequence[Image]
) -> tuple[NDArray[np.float32], CameraNoise]:
    """Median background (H, W, 3), and the noise of single frames, from pixels without contact."""
    frames = [np.asarray(frame, np.float32) for frame in (background, *untouched)]
    free = [np.ones(background.shape[:2], bool) for _ in frames]
    rows, columns = np.indices(background.shape[:2])
    for press in () if len(untouched) >= ENOUGH_FRAMES else presses:
        x, y, radius = press.circle
        frames.append(press.image.astype(np.float32))
        free.append(np.hypot(columns - x, rows - y) > _UNTOUCHED * radius)
    level = np.array([np.median((f - frames[0])[m], axis=0) for f, m in zip(frames, free, strict=True)])
    still = np.stack(frames) - level[:, None, None].astype(np.float32)
    still[~np.stack(free)] = np.nan
    # the median, because light that a contact takes away far from it counts as untouched in some presses
    median, count = np.nanmedian(still, axis=0).astype(np.float32), np.stack(free).sum(axis=0)
    # a Wiener filter removes the noise that is left in the median of few frames; dust remains
    smooth = cv2.GaussianBlur(median, (0, 0), _NOISE_PX)
    scatter = np.nanmean((still[:, ::4, ::4] - median[::4, ::4]) ** 2, axis=(0, 1, 2))
    left = scatter * _MEDIAN_VARIANCE / np.maximum(count, 1)[..., None]
    local = cv2.GaussianBlur((median - smooth) ** 2, (0, 0), 2.0 * _NOISE_PX)
    kept = np.maximum(1.0 - left / np.maximum(local, 1e-6), 0.0)
    mean = np.asarray(smooth + kept * (median - smooth), np.float32)
    fine = []  # the noise of each frame without broad structure, which is light; 0 in contacts
    for frame, mask in zip(still, free, strict=True):
        noise = np.where(np.isnan(frame), 0.0, frame - mean)
        share = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _LIGHT_PX)[..., None]
        broad = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), _LIGHT_PX) / np.maximum(share, 0.05)
        fine.append(np.asarray(np.where(mask[..., None], noise - broad, 0.0), np.float32))
    return mean, measure_noise(fine, free)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """A press that was left out of the fit.

    rms_grey: error of the colour change rendered with the given circle, corrected by the mean adjustment of
    the other presses. adjusted_grey: the same with the adjusted circle. change_grey: rms of the change
    itself, which is the error of a model that predicts no change.
    """

    id: str
    rms_grey: float
    adjusted_grey: float
    change_grey: float


@dataclass(frozen=True, slots=True, eq=False)
class LookFit:
    """A look and its held-out errors, one per press. presses: with adjusted circles."""

    look: GelLook
    held_out: tuple[HeldOut, ...]
    presses: tuple[Pressed, ...]

    @property
    def error_share(self) -> float:
        """Held-out error relative to the colour change, rms over the presses; 1 for predicting no change."""
        missed = np.mean([press.rms_grey**2 for press in self.held_out])
        return float(np.sqrt(missed / np.mean([press.change_grey**2 for press in self.held_out])))


def fit_look(
    presses: Sequence[Pressed],
    background: Image,
    mm_per_px: tuple[float, float],
    untouched: Sequence[Image] = (),
) -> LookFit:
    """Fit the look of a unit; the terms that held-out presses do not support are left out.

    untouched: further frames without contact, for noise and background; without them both come from the
    untouched parts of the presses. Raises `CalibrationError` for fewer than eight presses.
    """
    if len(presses) < FEWEST:
        raise CalibrationError(f"gel: {plural(len(presses), 'usable picture')}, {FEWEST} are needed")
    mean, noise = background_and_noise(presses, background, untouched)
    largest = GelLook(mean, np.zeros((0, 3)), *_MODELS[-1], mm_per_px, noise, jpeg_quality(background))
    adjusted = list(presses)
    for _ in range(_ROUNDS):
        total = _total([_sums_of(press, press.circle, largest) for press in adjusted])
        weights = _solve(total, np.arange(len(total.squares)))
        pairs = zip(adjusted, presses, strict=True)
        adjusted = [_adjust(press, first.circle, weights, largest) for press, first in pairs]
    sums = [_sums_of(press, press.circle, largest) for press in adjusted]
    model, used = _best_model(sums)
    drawn = _circles_as_given(presses, adjusted)
    held_out = []
    for i, press in enumerate(adjusted):
        weights = _solve(_total(sums, without=i), used)
        as_given = _sums_of(press, drawn[i], largest)
        errors = as_given.error(weights, used), sums[i].error(weights, used)
        held_out.append(HeldOut(press.id, *errors, float(np.sqrt(as_given.power / as_given.count))))
    look = GelLook(mean, _solve(_total(sums), used), *model, mm_per_px, noise, largest.jpeg_quality)
    return LookFit(look, tuple(held_out), tuple(adjusted))


def ball_dent(
    circle: Circle, radius_mm: float, shape: tuple[int, int], mm_per_px: tuple[float, float]
) -> Array:
    """Depth of the gel, (H/2, W/2) mm, under a ball whose contact is a circle. shape: (H, W)."""
    rows, columns = shape[0] // HALF, shape[1] // HALF
    x = ((np.arange(columns) * HALF + 0.5) - circle[0]) * mm_per_px[0]
    y = ((np.arange(rows) * HALF + 0.5) - circle[1]) * mm_per_px[1]
    apart = x[None, :] ** 2 + y[:, None] ** 2
    contact_mm = min(circle[2] * mm_per_px[0], 0.95 * radius_mm)
    from_middle = (np.array(circle[:2]) - np.array(shape[::-1]) / 2.0 + 0.5) * mm_per_px
    # the gel's face falls away from its middle, so a ball beside it touches nearer to the middle
    fall = x[None, :] * from_middle[0] + y[:, None] * from_middle[1] + (apart - contact_mm**2) / 2.0
    depth = np.sqrt(np.maximum(radius_mm**2 - apart, 0.0)) - np.sqrt(radius_mm**2 - contact_mm**2)
    pressed = np.maximum(depth - fall / DOME_MM, 0.0).astype(np.float32)
    pressed[apart >= radius_mm**2] = 0.0
    return membrane(pressed, pressed, HALF * mm_per_px[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Normal equations of the pixels of a press.

    power: sum of the squared colour changes; count: number of them.
    """

    squares: Array
    products: Array
    power: float
    count: int

    def error(self, weights: Array, used: NDArray[np.intp]) -> float:
        explained = (weights * (self.squares[np.ix_(used, used)] @ weights - 2.0 * self.products[used])).sum()
        return float(np.sqrt(max(self.power + explained, 0.0) / self.count))


def _sums_of(press: Pressed, circle: Circle, look: GelLook) -> _Sums:
    where = _window(press.circle, look.shape)
    system, target = _design(press, circle, look, where), _target(press, look, where)
    return _Sums(system.T @ system, system.T @ target, float((target**2).sum()), target.size)


def _total(sums: Sequence[_Sums], without: int | None = None) -> _Sums:
    kept = [each for i, each in enumerate(sums) if i != without]
    return _Sums(
        sum((s.squares for s in kept[1:]), kept[0].squares),
        sum((s.products for s in kept[1:]), kept[0].products),
        sum(s.power for s in kept),
        sum(s.count for s in kept),
    )


def _solve(sums: _Sums, used: NDArray[np.intp]) -> NDArray[np.float64]:
    """(U, 3) ridge-regularised weights of the columns in use, scaled to unit mean square."""
    squares, products = sums.squares[np.ix_(used, used)], sums.products[used]
    scale = np.sqrt(np.diag(squares)) + 1e-9
    system = squares / scale[:, None] / scale + _RIDGE * np.eye(len(scale))
    return np.asarray(np.linalg.solve(system, products / scale[:, None]) / scale[:, None])


def _best_model(sums: Sequence[_Sums]) -> tuple[Model, NDArray[np.intp]]:
    """The smallest model that no larger one beats clearly on presses left out, and its columns."""
    best = np.inf, _MODELS[-1], np.arange(len(sums[0].squares))
    for model in _MODELS:
        used = _columns(model, len(sums[0].squares))
        errors = [each.error(_solve(_total(sums, without=i), used), used) for i, each in enumerate(sums)]
        error = float(np.sqrt(np.mean(np.square(errors))))
        if error < _BETTER * best[0]:
            best = error, model, used
    return best[1], best[2]


def _columns(model: Model, features: int) -> NDArray[np.intp]:
    """Return the columns of the largest model's features that a model uses, in the order of its weights."""
    degree, by_background, shadows = model
    most, monomials = _MODELS[-1][0], lambda n: (n + 1) * (n + 2) // 2
    places = [
        *range(monomials(degree)),
        *(range(monomials(most), monomials(most) + 3) if by_background else ()),
    ]
    slopes, count = SLOPE_TERMS, monomials(most) + 3
    lost = range(slopes * count, features) if shadows else ()
    return np.array([*(slope * count + place for slope in range(slopes) for place in places), *lost])


def _adjust(press: Pressed, first: Circle, weights: Array, look: GelLook) -> Pressed:
    """Move and widen a circle by one Gauss-Newton step so that the rendered press fits its photograph."""
    where = _window(press.circle, look.shape)
    now = _design(press, press.circle, look, where) @ weights
    columns = []
    for k in range(3):
        moved = np.array(press.circle)
        moved[k] += _STEP_PX
        columns.append(((_design(press, tuple(moved), look, where) @ weights - now) / _STEP_PX).ravel())
    system = np.vstack([np.column_stack(columns), _PRIOR_GREY * np.eye(3)])
    missed = np.concatenate([(_target(press, look, where) - now).ravel(), np.zeros(3)])
    step = np.clip(np.linalg.lstsq(system, missed, rcond=None)[0], -_MOST_STEP_PX, _MOST_STEP_PX)
    x, y, radius = np.add(press.circle, step)
    bounded = float(np.clip(radius, 0.5 * first[2], 2.5 * first[2]))
    return replace(press, circle=(float(x), float(y), bounded))


def _circles_as_given(given: Sequence[Pressed], adjusted: Sequence[Pressed]) -> list[Circle]:
    """Return each given circle, corrected by the mean adjustment of the circles of the other presses.

    The correction is a shift, linear in the position, and a factor on the radius.
    """
    first, last = (np.array([press.circle for press in of]) for of in (given, adjusted))
    at = np.column_stack([np.ones(len(first)), first[:, :2]])
    found: list[Circle] = []
    for i, (x, y, radius) in enumerate(first.tolist()):
        others = np.arange(len(first)) != i
        dx, dy = at[i] @ np.linalg.lstsq(at[others], (last - first)[others, :2], rcond=None)[0]
        wider = float(np.median(last[others, 2] / first[others, 2]))
        found.append((float(x + dx), float(y + dy), radius * wider))
    return found


def _window(circle: Circle, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask (h, w) of a press at half resolution, with every second pixel: neighbours are alike."""
    rows, columns = np.indices((shape[0] // HALF, shape[1] // HALF))
    near = np.hypot(columns * HALF + 0.5 - circle[0], rows * HALF + 0.5 - circle[1]) < _AROUND * circle[2]
    return near & ((rows + columns) % 2 == 0)


def _design(press: Pressed, circle: Circle, look: GelLook, where: NDArray[np.bool_]) -> Array:
    """(N, F) features of the largest model at the pixels of a press, if its contact were a circle."""
    dent = ball_dent(circle, press.radius_mm, look.shape, look.mm_per_px)
    slopes = slope_terms(dent, look.mm_per_px)[:, where]
    products = (slopes[:, None] * look.places[None, :, where]).reshape(-1, slopes.shape[1])
    lost = shadow_terms(dent, HALF * look.mm_per_px[0])[:, where]
    return np.concatenate([products, lost]).T.astype(np.float64)


def _target(press: Pressed, look: GelLook, where: NDArray[np.bool_]) -> Array:
    """(N, 3) colour change that a photograph shows at the pixels of a press."""
    change = press.image.astype(np.float32) - look.background
    half = cv2.resize(change, (where.shape[1], where.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(half[where], np.float64)
