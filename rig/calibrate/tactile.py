"""`rig calibrate tactile`: a gel's scale and colour map from a folder of ball presses."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from calibration.gel.balls import BallFit, BallPress, calibrate_gel
from calibration.gel.presses import find_press, rim_centre
from calibration.gel.reference import Reference, assess_reference
from calibration.gel.scale import GelScale, fit_scale
from calibration.verdict import Assessment, Rejected
from drivers.errors import CalibrationError, InputError
from drivers.formats import read_csv_rows
from drivers.images import read_image
from drivers.types import Image
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import number

NOMINAL_MM_PER_PX = (0.060, 0.060)
"""Of a DIGIT at 240 x 320; a ball's radius does not depend on it, what is measured in mm does."""


@dataclass(slots=True)
class _PressFolder:
    """The samples of a folder. moves_mm: place of the ball by id, x right and y down in the picture."""

    background: Image
    found: list[BallPress] = field(default_factory=list)
    rejected: list[Rejected] = field(default_factory=list)
    moves_mm: dict[str, tuple[float, float]] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)


def tactile_from_folder(
    folder: Path, serial: str, mm_per_px: tuple[float, float] | None
) -> CalibrationResult:
    """background.png, and catalog.csv with its pictures: the gel's scale and colour map.

    mm_per_px: along x and y where it is known; else it is fitted to the known moves of the presses
    (columns x_mm, y_mm), or taken as a DIGIT's, with a doubt. A map that fails its own test is left
    out where there is a fitted scale to keep.
    """
    presses = _read(folder)
    result = CalibrationResult(
        "tactile",
        {"tactile": serial},
        Assessment(),
        str(folder),
        rejected=presses.rejected,
        files=presses.files,
        thumbnails=[Thumbnail.of(r, folder / r.id, grey=False) for r in presses.rejected],
    )
    try:
        scale = None if mm_per_px else _scale(presses)
        used = mm_per_px or (scale.mm_per_px if scale else NOMINAL_MM_PER_PX)
        across, along = (float(v) for v in used)
        fit = calibrate_gel(presses.found, (across, along))
    except CalibrationError as error:
        return replace(result, assessment=Assessment((str(error),)))
    mapped = not (fit.assessment.refusals and scale)
    saturated = float((presses.background >= 250).mean())
    still = Reference(presses.background.astype(np.float32), 0.0, saturated, 0)
    assessment = (fit.assessment if mapped else _without_map(fit.assessment)) + assess_reference(still)
    if scale is not None:
        assessment += scale.assessment
    elif mm_per_px is None:
        assessment += Assessment(
            doubts=("mm per px is a DIGIT's nominal 0.06: give --mm-per-px, or x_mm and y_mm in catalog.csv",)
        )
    return replace(
        result,
        assessment=assessment,
        value=_value(fit, (across, along), scale, mapped),
        quality=_quality(fit, scale),
        numbers=_numbers(fit, (across, along), scale),
        used=len(fit.true_mm),
        rejected=[*presses.rejected, *fit.rejected],
        pictures=[*_residuals(scale, presses.background), *_pictures(fit, presses.found)],
    )


def _read(folder: Path) -> _PressFolder:
    """Find the press in every picture of the catalog. Raises `InputError` naming file and line."""
    path, untouched = folder / "catalog.csv", folder / "background.png"
    rows = read_csv_rows(path, ("image", "diameter(mm)"))
    presses = _PressFolder(read_image(untouched), files=[untouched, path])
    for line, row in rows:
        where, name = f"{path} line {line}", row["image"]
        if not name or not (folder / name).is_file():
            raise InputError(f"{where}: {name} is not in {folder}")
        background = read_image(folder / row["background"]) if row.get("background") else presses.background
        presses.files.append(folder / name)
        found = find_press(read_image(folder / name), background.astype(np.float32), name)
        if isinstance(found, str):
            presses.rejected.append(Rejected(name, found))
            continue
        presses.found.append(BallPress(found, number(row, "diameter(mm)", where) / 2.0))
        if row.get("x_mm") and row.get("y_mm"):
            presses.moves_mm[name] = number(row, "x_mm", where), number(row, "y_mm", where)
    return presses


def _scale(presses: _PressFolder) -> GelScale | None:
    """The scale from known moves; None where the catalog has none. Raises `CalibrationError`."""
    moved = [p for p in presses.found if p.press.id in presses.moves_mm]
    if not moved:
        return None
    moves = np.array([presses.moves_mm[p.press.id] for p in moved])
    centres = np.array([rim_centre(p.press) for p in moved])
    return fit_scale(moves, centres, np.array([p.radius_mm for p in moved]))


def _without_map(assessment: Assessment) -> Assessment:
    """A scale from known moves stands without the colours: what is wrong with their map is a doubt."""
    return Assessment(doubts=tuple(f"colour map left out: {reason}" for reason in assessment.reasons))


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
    text = "Each arrow points from where the known move and the scale put a contact to where it was seen."
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
