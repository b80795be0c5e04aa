"""How one sensor unit looks: the colour that a dent of its gel changes, its background, its noise.

The colour change is linear in products of slope terms and place terms, plus light that is lost in the
neighbourhood of a dent. All of it is fitted to photographs of pressed balls (`calibration.gel.look_fit`).

`visibility` compares the colours with the noise. The three LEDs stand on different sides, so that a slope in
any direction changes a colour. Where the light of two LEDs comes from opposite sides and the third is weak,
slopes in one direction change hardly anything.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.noise import CameraNoise
from calibration.store import load
from drivers.errors import CalibrationError
from drivers.formats import check_zip, reason

Plane = NDArray[np.float32]
Weights = NDArray[np.float64]

SCHEMA = 2
HALF = 2
"""Image pixels per pixel of the geometry."""
_KNEE = 0.3
"""Slope (mm/mm) at which the slope terms begin to saturate; 0.2 to 0.6 fit 31 presses of D20641 alike."""
_SLOPE_DEGREE = 3
SLOPE_TERMS = (_SLOPE_DEGREE + 1) * (_SLOPE_DEGREE + 2) // 2 - 1
_SHADOW_MM = (0.75, 1.5, 3.0)
_SHADOW_WAYS = 8
_NEAR_MM, _NEAR_SHARE, _FAR_MM, _FAR_SHARE, _FILM_MM = 1.4, 0.7, 3.3, 0.4, 0.5
"""Reach of the gel's membrane round a contact, and the share of the depth it keeps. Of five sets, the one
with the lowest held-out error on 31 presses of D20641."""
DOME_MM = 46.0
"""Radius of the gel's convex face. On 31 presses of D20641 with this radius, adjusted circles agree with the
hand-drawn ones all over the gel; a flat gel has them 10 px apart, 5 mm from the middle."""
_GLOW_SMOOTH_PX = 4.0
_SHOWN_SLOPE = 0.1
"""Slope (mm/mm) of a broad contact, as of a bottle in the fingers."""
_GRID_PX = 20


@dataclass(frozen=True, eq=False)
class GelLook:
    """The look of one unit.

    background: (H, W, 3) float32 grey levels, RGB, untouched. weights: (F, 3), columns R, G, B.
    place_degree: of the place terms; by_background: whether the local background scales the slope terms;
    shadows: whether light lost beside a dent is modelled. mm_per_px: along x and y. noise: of single
    frames, as the untouched gel showed it. jpeg_quality: None if the frames
    show no JPEG compression. about: serial, ball, presses and held-out errors, as in the file.
    turn_rad: how far the LEDs are turned (only in varied looks).
    """

    background: Plane
    weights: Weights
    place_degree: int
    by_background: bool
    shadows: bool
    mm_per_px: tuple[float, float]
    noise: CameraNoise
    jpeg_quality: int | None
    about: Mapping[str, Any] = field(default_factory=dict)
    turn_rad: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        return self.background.shape[0], self.background.shape[1]

    def draw_noise(self, shape: tuple[int, int], count: int, rng: np.random.Generator) -> Plane:
        return self.noise.draw(shape, count, rng)

    @property
    def dome_mm(self) -> float:
        return DOME_MM

    def dent(self, pressed: Plane, dragged: Plane) -> Plane:
        """Depth of the gel's film (h, w) mm under and around a contact.

        pressed: (h, w) mm under the object, at half the image's resolution. dragged: the same for the
        membrane beside the contact, which may trail behind the object.
        """
        return membrane(pressed, dragged, HALF * self.mm_per_px[0])

    def change(self, dent: Plane) -> Plane:
        """Colour change of a dent, (h, w, 3) float32 grey levels; dent: (h, w) mm at half resolution."""
        slopes = slope_terms(dent, self.mm_per_px, self.turn_rad)
        changed = np.zeros((3, *dent.shape), np.float32)
        for plane, factor in zip(slopes, self._maps, strict=True):
            changed += plane * factor
        if self.shadows:
            lost = shadow_terms(dent, HALF * self.mm_per_px[0])
            by_colour = self.weights[-len(lost) :].T.astype(np.float32)
            changed += (by_colour @ lost.reshape(len(lost), -1)).reshape(changed.shape)
        return np.ascontiguousarray(changed.transpose(1, 2, 0))

    @cached_property
    def places(self) -> Plane:
        """(P, h, w) monomials of the place, and the smoothed background's R, G, B, at half resolution."""
        rows, columns = self.shape[0] // HALF, self.shape[1] // HALF
        v, u = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j].astype(np.float32)
        terms = _monomials(u, v, self.place_degree)
        if not self.by_background:
            return terms
        half = cv2.resize(self.background, (columns, rows), interpolation=cv2.INTER_AREA)
        glow = cv2.GaussianBlur(half, (0, 0), _GLOW_SMOOTH_PX).transpose(2, 0, 1) / np.float32(100.0)
        return np.concatenate([terms, glow], dtype=np.float32)

    @cached_property
    def _maps(self) -> Plane:
        """Factor of each slope term at each place, (S, 3, h, w)."""
        places = self.places
        by_slope = self.weights[: SLOPE_TERMS * len(places)].reshape(SLOPE_TERMS, len(places), 3)
        return np.einsum("spc,phw->schw", by_slope, places).astype(np.float32)

    def with_background(self, background: Plane) -> "GelLook":
        scale = [
            mm * old / new
            for mm, old, new in zip(self.mm_per_px, self.shape[::-1], background.shape[1::-1], strict=True)
        ]
        return replace(self, background=background, mm_per_px=(scale[0], scale[1]))

    def pack(self) -> bytes:
        facts = {
            "schema": SCHEMA, "place_degree": self.place_degree, "by_background": self.by_background,
            "shadows": self.shadows, "mm_per_px": self.mm_per_px,
            "jpeg_quality": self.jpeg_quality, "about": dict(self.about), "turn_rad": self.turn_rad,
        }  # fmt: skip
        file = io.BytesIO()
        np.savez_compressed(
            file,
            facts=np.array(json.dumps(facts)),
            background=self.background.astype(np.float16),
            weights=self.weights,
            noise=self.noise.covariance.astype(np.float32),
        )
        return file.getvalue()

    def varied(self, seed: int, background: Plane | None = None) -> "GelLook":
        """A plausible other unit: LEDs turned by up to 25 degrees, gains changed, background of another.

        seed: draws the turn and the gains. background: (H, W, 3) of another unit; None keeps this one's
        with its colours mixed. The place terms and the shadows' directions stay as they are.
        """
        rng = np.random.default_rng((seed, 83))
        gains = rng.uniform(0.75, 1.25, 3) * rng.uniform(0.8, 1.2)
        turn = float(np.deg2rad(rng.uniform(-25.0, 25.0)))
        mixed = self.background @ (np.eye(3) + rng.uniform(-0.08, 0.15, (3, 3))).astype(np.float32)
        other = mixed * self.background.mean() / mixed.mean() if background is None else background
        return replace(
            self,
            background=np.clip(cv2.resize(other, self.shape[::-1]), 0, 255).astype(np.float32),
            weights=self.weights * gains,
            noise=self.noise.scaled(rng.uniform(0.7, 1.3)),
            about={**self.about, "varied": seed},
            turn_rad=turn,
        )


def membrane(pressed: Plane, dragged: Plane, px_mm: float) -> Plane:
    """Depth of the film, (h, w) mm: the object's depth, or the membrane's where that is deeper."""
    near, far, film = (2 * round((mm / px_mm - 1.0) / 2.0) + 1 for mm in (_NEAR_MM, _FAR_MM, _FILM_MM))
    beside = cv2.blur(cv2.blur(dragged, (near, near)), (near, near)) * np.float32(_NEAR_SHARE)
    wide = cv2.blur(cv2.blur(dragged, (far, far)), (far, far)) * np.float32(_FAR_SHARE)
    return np.asarray(cv2.blur(cv2.max(pressed, cv2.max(beside, wide)), (film, film)), np.float32)


def slope_terms(dent: Plane, mm_per_px: tuple[float, float], turn_rad: float = 0.0) -> Plane:
    """(S, h, w) monomials of the saturating slope of a dent (h, w) mm, without a constant.

    turn_rad: turns the slopes, which is the same as turning all LEDs.
    """
    x = cv2.Sobel(dent, cv2.CV_32F, 1, 0, scale=1.0 / (8.0 * HALF * mm_per_px[0] * _KNEE))
    y = cv2.Sobel(dent, cv2.CV_32F, 0, 1, scale=1.0 / (8.0 * HALF * mm_per_px[1] * _KNEE))
    shrink = np.float32(1.0) / np.sqrt(np.float32(1.0) + x * x + y * y)
    x, y = np.asarray(x * shrink, np.float32), np.asarray(y * shrink, np.float32)
    if turn_rad:
        cos, sin = np.float32(np.cos(turn_rad)), np.float32(np.sin(turn_rad))
        x, y = np.asarray(cos * x - sin * y, np.float32), np.asarray(sin * x + cos * y, np.float32)
    return _monomials(x, y, _SLOPE_DEGREE)[1:]


def shadow_terms(dent: Plane, px_mm: float) -> Plane:
    """(K, h, w) mm: depth, foot, and how much deeper the gel is some way off, in eight directions."""
    smooth = np.asarray(cv2.blur(dent, (9, 9)), np.float32)
    ways = np.arange(_SHADOW_WAYS) * (2.0 * np.pi / _SHADOW_WAYS)
    steps = [
        np.rint(far / px_mm * np.array([np.cos(way), np.sin(way)])) for far in _SHADOW_MM for way in ways
    ]
    terms = np.empty((2 + len(steps), *dent.shape), np.float32)
    terms[0] = dent
    terms[1] = smooth
    for term, (x, y) in zip(terms[2:], steps, strict=True):
        shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
        cv2.warpAffine(smooth, shift, dent.shape[::-1], dst=term, flags=cv2.INTER_NEAREST)
    np.maximum(terms[1:] - dent, 0.0, out=terms[1:])
    return terms


def visibility(look: GelLook) -> tuple[float, float, tuple[float, float]]:
    """Return the colour change by a slope of 0.1 in the direction that shows least, in sigma of the noise.

    Returns the median over the gel, the worst value, and its place (x, y) px.
    """
    grid = slice(_GRID_PX // 2, None, _GRID_PX)
    response = change_by_slope(look, _SHOWN_SLOPE)[grid, grid]
    whitened = np.linalg.solve(np.linalg.cholesky(look.noise.colours), response)
    least = np.linalg.svd(whitened, compute_uv=False)[..., 1]
    row, column = np.unravel_index(int(least.argmin()), least.shape)
    at = ((int(column) + 0.5) * _GRID_PX * HALF, (int(row) + 0.5) * _GRID_PX * HALF)
    return float(np.median(least)), float(least.min()), at


def change_by_slope(look: GelLook, slope: float) -> NDArray[np.float32]:
    """Colour change (h, w, 3, 2), grey levels, by a slope (mm/mm) along x and along y, without shadows."""
    slopes = replace(look, shadows=False, weights=look.weights[: SLOPE_TERMS * len(look.places)])
    rows, columns = (size // HALF for size in look.shape)
    across, along = (HALF * slope * mm for mm in look.mm_per_px)
    ramps = (
        np.arange(columns) * np.full((rows, 1), across),
        np.arange(rows)[:, None] * np.full(columns, along),
    )
    return np.stack([slopes.change(ramp.astype(np.float32)) for ramp in ramps], axis=-1)


def look_file(path: Path) -> Path:
    """Return the .npz file of a look: the given file, or the one that a YAML file names."""
    if path.suffix not in (".yaml", ".yml"):
        return path
    return path.parent / str(load(path, "tactile").value.get("look", f"{path.stem}.npz"))


def load_look(path: Path) -> GelLook:
    """Read a look: the .npz file, or the YAML file beside it. Raises `CalibrationError`."""
    path = look_file(path)
    try:
        data = io.BytesIO(path.read_bytes())
        with zipfile.ZipFile(data) as archive:
            check_zip(str(path), archive)
        with np.load(data, allow_pickle=False) as stored:
            facts = json.loads(str(stored["facts"]))
            if facts["schema"] != SCHEMA:
                raise ValueError(f"format {facts['schema']}, this version reads {SCHEMA}")
            across, along = facts["mm_per_px"]
            look = GelLook(
                stored["background"].astype(np.float32),
                stored["weights"].astype(np.float64),
                int(facts["place_degree"]),
                bool(facts["by_background"]),
                bool(facts["shadows"]),
                (float(across), float(along)),
                CameraNoise(stored["noise"].astype(np.float64)),
                facts["jpeg_quality"],
                facts["about"],
                float(facts["turn_rad"]),
            )
            look.change(np.zeros((look.shape[0] // HALF, look.shape[1] // HALF), np.float32))
    except FileNotFoundError as error:
        raise CalibrationError(f"{path}: no such look; rig calibrate tactile makes it") from error
    except Exception as error:
        raise CalibrationError(f"{path}: is not a gel's look ({reason(error)}); make it again") from error
    if not all(np.isfinite(array).all() for array in (look.background, look.weights, look.noise.covariance)):
        raise CalibrationError(f"{path}: holds numbers that are not finite; make it again")
    return look


def _monomials(x: Plane, y: Plane, degree: int) -> Plane:
    """(N, h, w), the constant first."""
    columns, rows = ([np.ones_like(axis)] for axis in (x, y))
    for _ in range(degree):
        columns.append(columns[-1] * x)
        rows.append(rows[-1] * y)
    return np.stack([columns[i] * rows[total - i] for total in range(degree + 1) for i in range(total + 1)])
