"""`rig calibrate tactile`: a gel's scale, colour map and look from a folder of ball presses."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from calibration.gel.balls import NULL_REFUSED, BallFit, BallPress, GelScale, calibrate_gel, fit_scale
from calibration.gel.look import GelLook
from calibration.gel.look_fit import LookFit, fit_look
from calibration.gel.presses import rim_centre
from calibration.gel.reference import Reference, assess_reference, drift_since
from calibration.gel.visibility import visibility
from calibration.verdict import Assessment, length_guess, limit
from drivers.errors import CalibrationError
from drivers.types import Image
from rig.calibrate import figures
from rig.calibrate.press_folder import PressFolder, read_press_folder
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail

NOMINAL_MM_PER_PX = (0.060, 0.060)
"""Scale of a DIGIT at 240 x 320 px. Lengths in mm depend on it; the radius of a ball does not."""


_DARK_GREY = 16.0
_LOST_SHARE = 0.05
"""Share of the picture with a dark or saturated colour from which the calibration is doubtful."""
_GEL_SIDE_MM = (5.0, 100.0)
"""Range of the longer side of the gel in a picture; 19 mm for a DIGIT."""
_GRID = (3, 4)
"""Columns and rows of the fields of a gel, each of which should have been pressed."""


def tactile_from_folder(
    folder: Path,
    serial: str,
    mm_per_px: tuple[float, float] | None,
    ball_mm: float | None = None,
    background: Path | None = None,
    circles: Path | None = None,
    untouched: Path | None = None,
) -> CalibrationResult:
    """Fit a gel's scale, colour map and look to a folder of presses, as `read_press_folder` reads it.

    mm_per_px: along x and y if known; else it is fitted to the known moves of the presses (columns x_mm,
    y_mm), or that of a DIGIT, reported as a doubt. If the colour map fails its test, only the fitted scale is
    kept.
    """
    presses = read_press_folder(folder, ball_mm, background, circles, untouched)
    result = CalibrationResult(
        "tactile",
        {"tactile": serial},
        Assessment(),
        str(folder),
        rejected=presses.rejected,
        files=presses.files,
        thumbnails=[Thumbnail.of(r, presses.folder / r.id, grey=False) for r in presses.rejected],
    )
    try:
        scale = None if mm_per_px else _scale(presses)
        used = mm_per_px or (scale.mm_per_px if scale else NOMINAL_MM_PER_PX)
        across, along = (float(v) for v in used)
        _require_gel(presses.background, (across, along))
        fit = calibrate_gel(presses.found, (across, along))
        look = fit_look(presses.pressed, presses.background, (across, along), presses.untouched)
    except CalibrationError as error:
        return replace(result, assessment=Assessment((str(error),)))
    mapped = not (fit.assessment.refusals and scale)
    assessment = fit.assessment
    if not mapped:  # a scale from known moves is valid without the map
        left_out = tuple(f"colour map left out: {reason}" for reason in assessment.reasons)
        assessment = Assessment(doubts=left_out)
    assessment += _assess_look(look) + _dark_or_saturated(fit, presses.background)
    assessment += _assess_background(presses.background, look.look)
    if scale is not None:
        assessment += scale.assessment
    elif mm_per_px is None:
        assessment += Assessment(
            doubts=("mm per px is a DIGIT's nominal 0.06: give --mm-per-px, or x_mm and y_mm in catalog.csv",)
        )
    about = {
        "serial": serial,
        "balls_mm": sorted({2.0 * p.radius_mm for p in presses.pressed}),
        "presses": len(presses.pressed),
        "held_out_grey": {p.id: round(p.rms_grey, 2) for p in look.held_out},
        "error_share": round(look.error_share, 3),
    }
    return replace(
        result,
        assessment=assessment,
        value=_value(fit, (across, along), scale, mapped) | {"look": f"tactile-{serial}.npz"},
        quality=_quality(fit, scale) | _look_quality(look),
        numbers=_numbers(fit, (across, along), scale) | _look_numbers(look),
        used=len(fit.true_mm),
        rejected=[*presses.rejected, *fit.rejected],
        pictures=[*_residuals(scale, presses.background), *_pictures(fit, presses.found)],
        attached={".npz": replace(look.look, about=about).packed()},
    )


def _require_gel(background: Image, mm_per_px: tuple[float, float]) -> None:
    """Raise `CalibrationError`, with a guess of the unit, for a scale that no gel has."""
    rows, columns = background.shape[:2]
    side_mm = max(columns * mm_per_px[0], rows * mm_per_px[1])
    low, high = _GEL_SIDE_MM
    if not low <= side_mm <= high:
        guess = length_guess(1e-3 * side_mm, "mm", 1e-3 * low, 1e-3 * high)
        raise CalibrationError(
            f"gel scale: the longer side of the picture is {side_mm:.3g} mm; gels have {low:g} to {high:g} "
            f"mm: x_mm and y_mm (or --mm-per-px) are not in mm{guess}"
        )


def _assess_look(fit: LookFit) -> Assessment:
    """Assess the look by held-out colour errors and by the fields without a press."""
    assessment = limit(
        100.0 * fit.error_share, 60.0, 90.0,
        "presses left out are rendered with {value:.0f} % of their colour change wrong: press more places",
    )  # fmt: skip
    bare = unpressed_fields([press.circle for press in fit.presses], fit.look.shape)
    if bare:
        places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in bare)
        assessment += Assessment(doubts=(f"no press reaches x, y = {places} px: press a ball there",))
    return assessment


def unpressed_fields(
    circles: Sequence[tuple[float, float, float]], shape: tuple[int, int]
) -> list[tuple[float, float]]:
    """Return the middles (x, y) px of the fields of a gel that no contact reaches. shape: rows, columns."""
    (across, down), (rows, columns) = _GRID, shape
    middles = [
        ((i + 0.5) * columns / across, (j + 0.5) * rows / down) for j in range(down) for i in range(across)
    ]
    return [
        (x, y) for x, y in middles if all(np.hypot(x - cx, y - cy) > radius for cx, cy, radius in circles)
    ]


def _dark_or_saturated(fit: BallFit, background: Image) -> Assessment:
    """Return dark or saturated colours as the reason for a failed or doubtful map."""
    dark = float((background.min(axis=2) < _DARK_GREY).mean())
    bright = float((background.max(axis=2) >= 250).mean())
    text = (
        f"in {dark:.0%} of the picture a colour has less than {_DARK_GREY:.0f} grey levels, and in "
        f"{bright:.0%} one is saturated: there slopes hardly change it; change the exposure or the LEDs' "
        "intensity, or press this unit more often"
    )
    lost = dark + bright > _LOST_SHARE
    if fit.assessment.refusals and (lost or fit.null_rms >= NULL_REFUSED):
        return Assessment((text,))
    return Assessment(doubts=(text,) if lost else ())


def _assess_background(background: Image, look: GelLook) -> Assessment:
    """Compare the background with the untouched parts of all presses, to find a contact in it."""
    still = Reference(background.astype(np.float32), 0.0, float((background >= 250).mean()), 0)
    assessment = assess_reference(still, drift_since(still, look.background))
    if assessment.reasons:
        cure = "background: take it again if anything touched the gel; give 30 frames without contact"
        assessment += Assessment(doubts=(f"{cure} with --untouched",))
    return assessment


def _look_quality(fit: LookFit) -> dict[str, object]:
    return {
        "look_error_share": fit.error_share,
        "look_held_out_grey": {p.id: p.rms_grey for p in fit.held_out},
        "look_held_out_adjusted_grey": {p.id: p.adjusted_grey for p in fit.held_out},
        "colour_change_grey": {p.id: p.change_grey for p in fit.held_out},
        "noise_grey": fit.look.noise.sigma_grey,
    }


def _look_numbers(fit: LookFit) -> dict[str, str]:
    def rms(values: Iterable[float]) -> float:
        return float(np.sqrt(np.mean(np.square(list(values)))))

    look = fit.look
    terms = [f"place to degree {look.place_degree}"]
    terms += ["local background"] if look.by_background else []
    terms += ["light lost beside a dent"] if look.shadows else []
    seen = visibility(look)
    noise = ", ".join(f"{sigma:.1f}" for sigma in look.noise.sigma_grey)
    return {
        "look, colour error of presses left out": (
            f"{rms(p.rms_grey for p in fit.held_out):.1f} grey from their circles, "
            f"{rms(p.adjusted_grey for p in fit.held_out):.1f} with circles adjusted, of a change of "
            f"{rms(p.change_grey for p in fit.held_out):.1f}"
        ),
        "look, terms that presses left out support": ", ".join(terms),
        "noise (R, G, B)": f"{noise} grey",
        "colour change by a slope of 0.1 in the direction that shows least": (
            f"{seen.median:.1f} sigma of the noise (median over the gel), {seen.worst:.1f} at worst, at "
            f"x, y = ({seen.worst_px[0]:.0f}, {seen.worst_px[1]:.0f}) px"
        ),
        "JPEG quality": "no compression found" if look.jpeg_quality is None else str(look.jpeg_quality),
    }


def _scale(presses: PressFolder) -> GelScale | None:
    """Fit the scale to known moves; None if the catalog has none. Raises `CalibrationError`."""
    moved = [p for p in presses.found if p.press.id in presses.moves_mm]
    if not moved:
        return None
    moves = np.array([presses.moves_mm[p.press.id] for p in moved])
    centres = np.array([rim_centre(p.press) for p in moved])
    return fit_scale(moves, centres, np.array([p.radius_mm for p in moved]))


def _value(
    fit: BallFit, mm_per_px: tuple[float, float], scale: GelScale | None, mapped: bool
) -> dict[str, object]:
    rows, columns = fit.map.shape
    value: dict[str, object] = {"image_height": rows, "image_width": columns, "mm_per_px": mm_per_px}
    if scale is not None:
        value["pixel_aspect"] = scale.pixel_aspect
    if mapped:
        value["gradient_map"] = {
            "features": "log colour change x place, calibration.gel.gradient_map",
            "weights": fit.map.weights,
        }
    return value


def _quality(fit: BallFit, scale: GelScale | None) -> dict[str, object]:
    quality: dict[str, object] = {
        "normal_rms_held_out": fit.normal_rms,
        "null_rms": fit.null_rms,
        "held_out_radius_mm": fit.held_out_mm,
        "radius_error": {f"{r:g} mm": e for r, e in fit.radius_error().items()},
    }
    if scale is not None:
        quality |= {
            "mm_per_px_sigma": scale.sigma,
            "pixel_aspect_sigma": scale.aspect_sigma,
            "moves_missed_px": scale.residual_px,
        }
    return quality


def _numbers(fit: BallFit, mm_per_px: tuple[float, float], scale: GelScale | None) -> dict[str, str]:
    across, along = mm_per_px
    numbers = {"scale along x, y": f"{across:.5f}, {along:.5f} mm per px"}
    if scale is not None:
        sx, sy = scale.sigma
        numbers["scale along x, y"] = f"{across:.5f} ± {sx:.5f}, {along:.5f} ± {sy:.5f} mm per px"
        numbers["pixel, width over height"] = f"{scale.pixel_aspect:.4f} ± {scale.aspect_sigma:.4f}"
    for radius, error in fit.radius_error().items():
        numbers[f"balls of {2 * radius:g} mm, left out"] = f"{100 * error:+.1f} % in radius (median)"
    return numbers | {
        "slope where nothing touches": f"{fit.null_rms:.4f}",
        "error of a normal's part, left out": f"{fit.normal_rms:.4f}",
    }


def _residuals(scale: GelScale | None, background: Image) -> list[Picture]:
    """Draw the residuals of the scale on the untouched gel; nothing without known moves of the presses."""
    if scale is None:
        return []
    grey = cv2.cvtColor(background, cv2.COLOR_RGB2GRAY)
    rows, columns = grey.shape
    vectors = -scale.missed_px
    shown = figures.arrows(
        scale.centres_px - vectors, vectors, (columns, rows), "residuals", np.asarray(grey, np.uint8)
    )
    text = "Each arrow points from the position of a contact by motion and scale to the measured one."
    return [Picture("Residuals of the scale", text, shown)]


def _pictures(fit: BallFit, presses: list[BallPress]) -> list[Picture]:
    rows, columns = fit.map.shape
    places = {}
    for radius in sorted(set(fit.true_mm.values())):
        x, y = np.array([fit.centres_px[i] for i, true in fit.true_mm.items() if true == radius]).T
        places[f"{2 * radius:g} mm"] = x, rows - y
    press = max((p.press for p in presses), key=lambda p: float(p.strength.max()))
    x, y = np.meshgrid(np.arange(0, columns, 2), np.arange(0, rows, 2))
    at = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    slopes = fit.map.slopes(press.change[y.ravel(), x.ravel()], at)[:, 0].reshape(x.shape)
    return [
        Picture(
            "Ball diameter of each press left out",
            "Estimated by the colour map that was fitted to the other presses.",
            figures.bars({i: 2 * fit.held_out_mm[i] for i in fit.true_mm}, "diameter, mm"),
        ),
        Picture(
            "Where the balls were pressed",
            "The colour map is not fitted where no ball was pressed.",
            figures.curves(places, "x, px", "up, px", "."),
        ),
        Picture(
            "Slopes of one press",
            f"{press.id}: the slope dz/dx that the colour map estimates.",
            figures.field(slopes, (columns, rows), "dz/dx"),
        ),
    ]
