"""The gel's colour map from presses of balls of known diameter, and its millimetres per pixel.

The contact of a ball is found in the picture: its centre and its width.
Inside a ball's contact the gel takes the ball's shape, so the surface normal there is the place
relative to the centre over the radius: n = (p - c) / R. The centres are not known; they are found
together with the map, alternately. Held-out presses check the map.

The scales along x and y come from a contact moved by known steps. They differ in real sensors (11.7
and 10.8 px per mm were reported for one). A gel is convex: where a ball touches it first lies nearer
to the gel's top than the ball, by 1 + R / (gel's radius). Balls of two sizes determine it, and the
scale is extrapolated to a ball of radius zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from calibration.gel.gradient_map import GradientMap, colour_change, fit_gradient_map
from calibration.gel.reference import check_light
from calibration.verdict import Assessment, Rejected, limits, sift
from drivers.errors import CalibrationError, plural
from drivers.types import Image

Array = NDArray[np.floating]

FEWEST_PRESSES = 8
_CORE = 0.7
"""Share of the rim's radius that is surely in contact; beyond, the gel leaves the ball."""
_LEAST_PIXELS = 30
_ROUNDS = 5
_ACROSS, _DOWN = (0.3, 0.7), (0.2, 0.4, 0.6, 0.8)
"""Places of the presses of a second ball, as shares of the image's width and height."""
NULL_REFUSED = 0.2
"""Slope of the map where nothing touches from which it is refused, mm/mm."""
BALLS_MM = (1.0, 100.0)
"""Smallest and largest diameter of a ball: smaller ones vanish in a gel, larger ones are flat on it."""
_THIN = 5
"""Every fifth pixel is used: after smoothing, neighbours carry the same information."""
_LEAST_CHANGE_GREY = 10.0
_SHARE_OF_PEAK = 0.3
_SMALLEST_RADIUS_PX = 8.0
_RIM_ROUNDS = 3
_RIM_RAYS = 180
_RIM_WIDTH_PX = 4.0
_FEWEST_POINTS = 12
"""Fewest points of an outline."""
_NOT_ROUND = "the contact is not round, or only a small part of it is in the picture"


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A ball's contact. change: (H, W, 3) colour change. strength: (H, W), its size in grey levels.

    radius_mm: of the ball. centre_px: (x, y). reach_px: radius of the changed area. rim_px: radius where the
    change falls most steeply.
    """

    id: str
    radius_mm: float
    change: NDArray[np.float32]
    strength: NDArray[np.float32]
    centre_px: tuple[float, float]
    reach_px: float
    rim_px: float


def find_press(image: Image, reference: NDArray[np.float32], name: str, radius_mm: float) -> Press | str:
    """Find the one round contact in a (H, W, 3) uint8 RGB picture, or return why there is none.

    Raises `CalibrationError` for a picture of another size, or one without light.
    """
    check_light(image, name)
    change = colour_change(image, reference)
    grey = cv2.GaussianBlur(image.astype(np.float32) - reference, (0, 0), 2.0)
    strength = np.linalg.norm(grey, axis=2).astype(np.float32)
    bound = max(_LEAST_CHANGE_GREY, _SHARE_OF_PEAK * float(np.percentile(strength, 99.5)))
    # the outline of the largest region, small holes closed
    changed = cv2.morphologyEx(
        (strength > bound).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)
    )
    outlines, _ = cv2.findContours(changed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=cv2.contourArea, default=np.zeros((0, 2))).reshape(-1, 2)
    if len(outline) < _FEWEST_POINTS:
        return f"no contact: nothing changed by more than {bound:.0f} grey"
    rows, columns = strength.shape
    inside = (outline > 1).all(axis=1) & (outline < (columns - 2, rows - 2)).all(axis=1)
    points = outline[inside].astype(np.float64)
    if len(points) < max(0.4 * len(outline), _FEWEST_POINTS):
        return _NOT_ROUND
    x, y, reach = circle_through(points)
    off = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - reach)
    if reach <= 0.0 or float(np.median(off)) > 0.25 * reach:
        return _NOT_ROUND
    if reach < _SMALLEST_RADIUS_PX:
        return f"the contact is {reach:.0f} px wide only: press harder"
    return Press(name, radius_mm, change, strength, (x, y), reach, rim_radius(strength, (x, y), reach))


def rim_radius(strength: Array, centre_px: tuple[float, float], reach_px: float) -> float:
    """Radius in px at which the change, averaged around the centre, falls most steeply."""
    rows, columns = np.indices(strength.shape)
    distance = np.hypot(columns - centre_px[0], rows - centre_px[1])
    near = distance < 1.2 * reach_px
    ring = distance[near].astype(int)
    counts = np.bincount(ring)
    profile = np.bincount(ring, strength[near]) / np.maximum(counts, 1)
    smooth = np.convolve(np.pad(profile, 2, mode="edge"), np.full(5, 0.2), "valid")
    first, last = int(0.35 * reach_px), max(int(1.1 * reach_px), int(0.35 * reach_px) + 2)
    fall = -np.gradient(smooth)[first : min(last, len(smooth))]
    return float(first + np.argmax(fall)) if len(fall) else reach_px


def rim_centre(press: Press) -> tuple[float, float]:
    """Centre of a contact (x, y) px, from its rim, where the change falls most steeply.

    The brightness of a slope depends on the light and on the place; its edge does not. So this centre
    follows the contact alone, as the centre of the bright area does not.
    """
    (x, y), reach = press.centre_px, press.reach_px
    for _ in range(_RIM_ROUNDS):
        angle = np.linspace(0.0, 2.0 * np.pi, _RIM_RAYS, endpoint=False)[:, None]
        radius = np.arange(0.55 * reach, 1.3 * reach, 0.5)
        rays = np.stack([x + np.cos(angle) * radius, y + np.sin(angle) * radius], axis=-1)
        values = cv2.remap(press.strength, rays.astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        # the centroid of the fall around its maximum
        fall, middle = np.maximum(-np.diff(values, axis=1), 0.0), (radius[1:] + radius[:-1]) / 2.0
        weight = fall * (np.abs(middle - middle[fall.argmax(axis=1)][:, None]) < _RIM_WIDTH_PX)
        edge = (weight * middle).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
        points = np.column_stack([x + np.cos(angle[:, 0]) * edge, y + np.sin(angle[:, 0]) * edge])
        rows, columns = press.strength.shape
        inside = (points > 2.0).all(axis=1) & (points < (columns - 3.0, rows - 3.0)).all(axis=1)
        x, y, reach = circle_through(points[inside])
        for _ in range(_RIM_ROUNDS):
            off = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - reach)
            inside &= off < max(3.0 * float(np.median(off[inside])), 0.7)
            x, y, reach = circle_through(points[inside])
    return x, y


def circle_through(points: Array) -> tuple[float, float, float]:
    """Circle (x, y, radius) closest to (N, 2) points (Kasa fit: linear least squares)."""
    middle = points.mean(axis=0)
    from_middle = points - middle
    system = np.column_stack([2.0 * from_middle, np.ones(len(points))])
    (cx, cy, rest), *_ = np.linalg.lstsq(system, (from_middle**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(rest + cx**2 + cy**2, 0.0)))
    return float(middle[0] + cx), float(middle[1] + cy), radius


@dataclass(frozen=True, slots=True, eq=False)
class BallFit:
    """The map, and its errors on held-out presses.

    held_out_mm: radius each press gives when it is left out, by id. normal_rms: rms error of a
    component of the normal in those. null_rms: rms of a component where nothing touches. centres_px: found.
    """

    map: GradientMap
    held_out_mm: dict[str, float]
    true_mm: dict[str, float]
    normal_rms: float
    null_rms: float
    centres_px: dict[str, tuple[float, float]]
    rejected: tuple[Rejected, ...]

    def radius_error(self) -> dict[float, float]:
        """Relative error of the median held-out radius, by true radius in mm."""
        errors: dict[float, float] = {}
        for radius in sorted(set(self.true_mm.values())):
            found = [self.held_out_mm[i] for i, true in self.true_mm.items() if true == radius]
            errors[radius] = float(np.median(found)) / radius - 1.0
        return errors

    @property
    def assessment(self) -> Assessment:
        """By the errors of held-out presses, the slope where nothing touches, and the number of presses."""
        errors = self.radius_error()
        spread = np.array([abs(self.held_out_mm[i] / true - 1.0) for i, true in self.true_mm.items()])
        worst = max(abs(e) for e in errors.values())
        tenth, few = float(np.percentile(spread, 90)), plural(len(self.true_mm), "picture")
        assessment = limits(
            (100 * worst, 5.0, 25.0,
             "balls left out come out {value:.0f} % wrong in radius (median per ball)"),
            (100 * tenth, 15.0, 60.0, "one press in ten is off by {value:.0f} %"),
            (self.null_rms, 0.03, NULL_REFUSED,
             "where nothing touches, the slope is {value:.3f} and not zero",
             "slope where nothing touches: {value:.3f}"),
            (len(self.true_mm), 20, FEWEST_PRESSES, f"{few} of presses; 30 all over the gel are good"),
        )  # fmt: skip
        if len(errors) > 1:
            return assessment
        pressed_mm = 2.0 * next(iter(errors))
        rows, columns = self.map.shape
        places = ", ".join(f"({x * columns:.0f}, {y * rows:.0f})" for y in _DOWN for x in _ACROSS)
        doubt = (
            f"one ball diameter, {pressed_mm:g} mm: a wrong scale or diameter would go unseen; press another "
            f"ball, of {0.7 * pressed_mm:.0f} mm or less, at x, y = {places} px, and name each picture's "
            "ball in catalog.csv"
        )
        return assessment + Assessment(doubts=(doubt,))


def calibrate_gel(presses: Sequence[Press], mm_per_px: tuple[float, float], folds: int = 8) -> BallFit:
    """Fit the colour map to presses all over the gel; every press is left out once to check it.

    mm_per_px: along x and y. Raises `CalibrationError` for fewer than eight presses, or a ball
    too small for its press.
    """
    good, rejected = sift(presses, lambda p: p.id, lambda p, _: _fault(p, mm_per_px))
    if len(good) < FEWEST_PRESSES:
        why = "; ".join(f"{r.id}: {r.reason}" for r in rejected[:5])
        raise CalibrationError(
            f"gel: {plural(len(good), 'usable picture')} of presses, {FEWEST_PRESSES} are the least ({why})"
        )
    for _ in range(_ROUNDS):
        fitted = _fit_to(good, mm_per_px)
        good = [_centre(press, fitted, mm_per_px) for press in good]
    held_out: dict[str, float] = {}
    errors, nulls = [], []
    folds = min(folds, len(good))
    for fold in range(folds):
        fitted = _fit_to([p for i, p in enumerate(good) if i % folds != fold], mm_per_px)
        for press in good[fold::folds]:
            held_out[press.id] = ball_radius_mm(press, fitted, mm_per_px)
            change, places, truth = _samples(press, mm_per_px)
            errors.append(_rms(fitted.normals(change, places) - truth))
            # far from the contact the normal's components should be zero
            change, places = _flat_pixels(press)
            nulls.append(_rms(fitted.normals(change, places)) if len(places) else 0.0)
    return BallFit(
        _fit_to(good, mm_per_px),
        held_out,
        {p.id: p.radius_mm for p in good},
        normal_rms=_rms(errors),
        null_rms=_rms(nulls),
        centres_px={p.id: p.centre_px for p in good},
        rejected=tuple(rejected),
    )


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _fit_to(presses: Sequence[Press], mm_per_px: tuple[float, float]) -> GradientMap:
    rows, columns = presses[0].strength.shape
    change, places, normals = zip(*(_samples(press, mm_per_px) for press in presses), strict=True)
    still, away = zip(*(_flat_pixels(press) for press in presses), strict=True)
    change, places = [*change, *still], [*places, *away]
    normals = [*normals, np.zeros((sum(map(len, away)), 2))]
    return fit_gradient_map(np.vstack(change), np.vstack(places), np.vstack(normals), (rows, columns))


def ball_radius_mm(press: Press, fitted: GradientMap, mm_per_px: tuple[float, float]) -> float:
    """Radius of the ball of a press, mm, from the map's normals: p = c + R n by least squares.

    The place is regressed on the normal, not the other way round: a fitted map gives the mean
    normal for a colour, which leaves its errors uncorrelated with what it gives.
    """
    change, places = core_pixels(press)
    normals = fitted.normals(change, places)
    where = places * mm_per_px
    from_mean, off = normals - normals.mean(axis=0), where - where.mean(axis=0)
    return float((from_mean * off).sum() / max((from_mean**2).sum(), 1e-12))


def core_pixels(press: Press) -> tuple[Array, Array]:
    """(N, 3) colour changes and (N, 2) px of the pixels that are surely in contact, thinned."""
    x, y = _pixels(press.strength.shape, _THIN)
    core = np.hypot(x - press.centre_px[0], y - press.centre_px[1]) < _CORE * press.rim_px
    x, y = x[core], y[core]
    return press.change[y, x], np.column_stack([x, y]).astype(np.float64)


def _samples(press: Press, mm_per_px: tuple[float, float]) -> tuple[Array, Array, Array]:
    change, places = core_pixels(press)
    return change, places, (places - press.centre_px) * mm_per_px / press.radius_mm


def _centre(press: Press, fitted: GradientMap, mm_per_px: tuple[float, float]) -> Press:
    """Return a press centred where its normals, times R, point back to."""
    change, places = core_pixels(press)
    back = places - fitted.normals(change, places) * press.radius_mm / np.asarray(mm_per_px)
    x, y = (float(v) for v in back.mean(axis=0))
    return replace(press, centre_px=(x, y), rim_px=rim_radius(press.strength, (x, y), press.reach_px))


def _flat_pixels(press: Press) -> tuple[Array, Array]:
    """(N, 3) colour changes and (N, 2) px far from the contact, where the slope is zero."""
    x, y = _pixels(press.strength.shape, 8 * _THIN)
    far = np.hypot(x - press.centre_px[0], y - press.centre_px[1]) > 2.5 * press.reach_px
    return press.change[y[far], x[far]], np.column_stack([x[far], y[far]]).astype(np.float64)


@lru_cache(maxsize=4)
def _pixels(shape: tuple[int, int], step: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of every `step`-th pixel, along a slant so that no row or column is missed."""
    rows, columns = (axis.ravel() for axis in np.indices(shape))
    chosen = (columns + 2 * rows) % step == 0
    return columns[chosen], rows[chosen]


def _fault(press: Press, mm_per_px: tuple[float, float]) -> str | None:
    low, high = BALLS_MM
    if not low <= 2.0 * press.radius_mm <= high:
        return f"a ball of {2.0 * press.radius_mm:g} mm; {low:g} to {high:g} mm fit a gel"
    if press.rim_px * _CORE * max(mm_per_px) >= press.radius_mm:
        return f"its contact is wider than a ball of {press.radius_mm:.2f} mm radius; is it given as radius?"
    if len(core_pixels(press)[0]) < _LEAST_PIXELS:
        return "too little of its contact is in the picture"
    return None


FEWEST = 4
_SIZES_APART = 1.2
_MOST_BULGE_PER_MM = 0.1
"""One over the smallest radius of curvature of a gel that is considered: 10 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class GelScale:
    """A gel's scale.

    mm_per_px: (2,) along x and y of the picture; sigma: (2,) one sigma of each; aspect_sigma: of
    their ratio, in which the bulge cancels. residual_px: rms.
    centres_px, missed_px: (N, 2) the contact centres, and the residual of each.
    """

    mm_per_px: Array
    sigma: Array
    aspect_sigma: float
    residual_px: float
    centres_px: Array
    missed_px: Array
    assessment: Assessment

    @property
    def pixel_aspect(self) -> float:
        return float(self.mm_per_px[0] / self.mm_per_px[1])


def fit_scale(moves_mm: Array, centres_px: Array, radii_mm: Array | None = None) -> GelScale:
    """Fit moves (N, 2) mm, x right and y down as the picture shows them, over contact centres (N, 2) px.

    radii_mm: (N,) of the balls; with two sizes a fifth apart the gel's bulge is fitted too. Raises
    `CalibrationError` for fewer than four places, numbers not finite, or moves along one line.
    """
    if moves_mm.shape != centres_px.shape or moves_mm.ndim != 2 or moves_mm.shape[1] != 2:
        raise CalibrationError("gel scale: (N, 2) moves in mm and as many centres in px are needed")
    if not (np.isfinite(moves_mm).all() and np.isfinite(centres_px).all()):
        raise CalibrationError("gel scale: a move or a centre is not finite")
    centred = moves_mm - moves_mm.mean(axis=0) if len(moves_mm) >= 2 else np.zeros((2, 2))
    spread = np.linalg.svd(centred, compute_uv=False)
    if len(moves_mm) < FEWEST or spread[-1] < 0.1 * spread[0] or spread[-1] < 0.1:
        raise CalibrationError(
            f"gel scale: {len(moves_mm)} places that do not span both axes; press at {FEWEST} places "
            "at least, some mm apart along x and along y"
        )
    apart = radii_mm is not None and np.max(radii_mm) >= _SIZES_APART * np.min(radii_mm)
    radii = np.asarray(radii_mm, np.float64) if apart else np.zeros(len(moves_mm))
    scale, missed = _fit(centres_px, moves_mm, radii)
    count = len(missed)
    left_out = [np.delete(np.arange(count), i) for i in range(count)]
    scales = np.array([_fit(centres_px[o], moves_mm[o], radii[o])[0] for o in left_out])
    sigma, aspect_sigma = jackknife_sigma(scales), float(jackknife_sigma(scales[:, 0] / scales[:, 1]))
    residual_px = float(np.sqrt((missed**2).sum(axis=1).mean()) / scale.mean())
    assessment = limits(
        (residual_px, 2.0, 15.0, "contact centres miss the known moves by {value:.1f} px"),
        (100 * float((sigma / scale).max()), 2.0, 20.0, "the scale is known to {value:.1f} % only"),
        (count, 6, FEWEST, "{value} places; 9 are good"),
    )
    return GelScale(scale, sigma, aspect_sigma, residual_px, centres_px, missed / scale, assessment)


def jackknife_sigma(values: Array) -> Array:
    """Return one sigma of an estimate from its N values, (N,) or (N, k), without one sample each."""
    count = len(values)
    return np.sqrt((count - 1) / count * ((values - values.mean(axis=0)) ** 2).sum(axis=0))


def _fit(centres_px: Array, moves_mm: Array, radii_mm: Array) -> tuple[Array, Array]:
    """Return (2,) mm per px along x and y, and the (N, 2) residuals of the moves in mm.

    radii_mm: (N,), all zero if balls of one size were used.
    """

    def solve(bulge_per_mm: float) -> tuple[Array, Array]:
        stretched = centres_px * (1.0 + bulge_per_mm * radii_mm[:, None])
        zeros = [np.ones(len(radii_mm)), *([radii_mm] if radii_mm.any() else [])]
        system = np.column_stack([stretched, *zeros])
        weights = np.linalg.lstsq(system, moves_mm, rcond=None)[0]
        return np.linalg.norm(weights[:2], axis=1), moves_mm - system @ weights

    if not radii_mm.any():
        return solve(0.0)
    found: Any = minimize_scalar(
        lambda bulge_per_mm: float((solve(bulge_per_mm)[1] ** 2).sum()),
        bounds=(0.0, _MOST_BULGE_PER_MM),
        method="bounded",
    )
    return solve(float(found.x))
