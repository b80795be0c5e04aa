"""`rig calibrate tactile`: a gel's scale, colour map and look from ball presses, and its picture at rest.

On a bench the fingers press balls of known diameter, or the fingertips take frames without contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from calibration.gel.balls import NULL_REFUSED, BallFit, GelScale, calibrate_gel, fit_scale, rim_centre
from calibration.gel.look import visibility
from calibration.gel.look_fit import LookFit, fit_look
from calibration.gel.reference import SATURATED, Reference, assess_reference, drift_since, make_reference
from calibration.verdict import Assessment, length_guess, limits
from drivers.errors import CalibrationError, InputError
from drivers.images import load_image
from drivers.types import Image
from protocols.capture_hand_eye import capture_still
from protocols.capture_touch import Touch, capture_presses
from rig.calibrate import charts
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions
from rig.calibrate.charts import Picture, thumbnails
from rig.calibrate.kind import Kind, Samples, SerialOption
from rig.calibrate.press_folder import PressFolder, read_press_folder
from rig.calibrate.result import CalibrationResult, Figure
from rig.calibrate.samples import write_picture, write_table
from rig.config import BenchConfig
from rig.config.parts import require_parts
from rig.declared import option

NOMINAL_MM_PER_PX = (0.060, 0.060)
"""Scale of a DIGIT at 240 x 320 px. Lengths in mm depend on it; the radius of a ball does not."""
_DARK_GREY = 16.0
_LOST_SHARE = 0.05
"""Share of the picture with a dark or saturated colour from which the calibration is doubtful."""
_GEL_SIDE_MM = (5.0, 100.0)
"""Range of the longer side of the gel in a picture; 19 mm for a DIGIT."""
_GRID = (3, 4)
"""Columns and rows of the fields of a gel, each of which should have been pressed."""
_FRAMES = 30
_REACH_MM = (3.6, 5.6)
"""How far from the gel's middle balls are pressed, across and along it."""
_GRIP_M = (0.0006, 0.0025)
"""Lightest and firmest press past contact, m: one and four steps of a Robotiq 3-Finger."""
_GOLDEN = (5.0**0.5 - 1.0) / 2.0
_CATALOG = "image,diameter(mm),x_mm,y_mm,background"


@dataclass(frozen=True)
class TactileOptions:
    """Calibrate a gel's scale and its map from colour to surface slope, from presses of balls.

    On a bench with --ball-mm the fingers press each ball at many places of both gels. The scale in mm per px
    is found from the steps of the arm. Without --ball-mm nothing moves: a frame of each fingertip without
    contact is stored as its reference, and compared with the previous reference (LEDs, gel, drift).

    The folder of --from holds background.png (without contact), catalog.csv and the pictures that it lists.
    Its columns are image and diameter(mm). Optional columns are x_mm and y_mm (position of the ball, to the
    right and down in the picture, from which the scale is found), and background (a picture without contact
    for this row). The balls are detected in the pictures. Without catalog.csv, --ball-mm is the diameter
    of the ball in all pictures.

    The look of the sensor is stored beside the file, in tactile-SERIAL.npz: its colours by slope and place,
    background, noise and JPEG quality. The key tactile.look of a bench file simulates a gel with it.

    Examples:
      rig calibrate tactile --from presses --ball-mm 8.8 --background bg.png --serial D20641
      rig calibrate tactile --bench fake
      rig calibrate tactile --bench fake --ball-mm 5 --ball-mm 9.5
      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1
    """

    balls_mm: list[float] | None = option(
        None, "On a bench: diameter of a ball to press, in mm; repeat for a second size.", "--ball-mm"
    )
    presses: int = option(16, "Number of presses of each ball.", min=8, max=100)
    mm_per_px: tuple[float, float] | None = option(
        None, "With --from: scale along x and y in mm per px, if known."
    )
    serial: SerialOption = "unknown"
    background: Path | None = option(None, "Picture without contact. Default: background.png of the folder.")
    circles: Path | None = option(
        None,
        "CSV of hand-drawn circles: frame, center_x, center_y, radius (px). Default: circles.csv.",
    )
    untouched: Path | None = option(
        None, "Folder of at least 8 frames without contact, for noise and background. Default: the presses'."
    )


def solve_tactile(samples: Samples, options: TactileOptions) -> CalibrationResult:
    """Fit a gel's scale, colour map and look to a folder of presses, as `read_press_folder` reads it.

    The scale, if not given, is fitted to the known moves of the presses (columns x_mm, y_mm), or is that of a
    DIGIT, reported as a doubt. If the colour map fails its test, only the fitted scale is kept.
    """
    folder, serial = samples.folder, options.serial
    ball_mm, *more_mm = options.balls_mm or [None]
    if more_mm:
        raise InputError("--ball-mm was given twice: name each picture's ball in catalog.csv instead")
    presses = read_press_folder(folder, ball_mm, options.background, options.circles, options.untouched)
    result = CalibrationResult(
        "tactile", {"tactile": serial}, {}, Assessment(), source=str(folder), rejected=presses.rejected,
        files=presses.files,
        thumbnails=thumbnails(
            presses.rejected, {r.id: presses.folder / r.id for r in presses.rejected}, grey=False
        ),
    )  # fmt: skip
    try:
        scale = _scale_of(presses, options.mm_per_px)
        _require_gel(presses.background, scale.mm_per_px)
        fit = calibrate_gel(presses.found, scale.mm_per_px)
        look = fit_look(presses.pressed, presses.background, scale.mm_per_px, presses.untouched)
    except CalibrationError as error:
        return replace(result, assessment=Assessment((str(error),)))
    mapped = not (fit.assessment.refusals and scale.fitted)
    rows, columns = fit.map.shape
    weights = {
        "features": "log colour change x place, calibration.gel.gradient_map",
        "weights": fit.map.weights,
    }
    about = {
        "serial": serial,
        "balls_mm": sorted({2.0 * p.radius_mm for p in presses.pressed}),
        "presses": len(presses.pressed),
        "held_out_grey": {p.id: round(p.rms_grey, 2) for p in look.held_out},
        "error_share": round(look.error_share, 3),
    }
    return replace(
        result,
        assessment=_assess_map(fit.assessment, mapped)
        + _assess_look(look)
        + _assess_light(fit, presses.background)
        + _assess_background(presses.background, look)
        + scale.assessment,
        layout={
            "image_height": rows,
            "image_width": columns,
            "look": f"tactile-{serial}.npz",
            **({"gradient_map": weights} if mapped else {}),
        },
        figures=[*_figures_of_scale(scale), *_figures(fit, look)],
        used=len(fit.true_mm),
        rejected=[*presses.rejected, *fit.rejected],
        pictures=_pictures(fit, presses, scale.fitted),
        attached={".npz": replace(look.look, about=about).pack()},
    )


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale of a gel along x and y. fitted: to the known moves of the presses; None if it was not."""

    mm_per_px: tuple[float, float]
    assessment: Assessment = field(default_factory=Assessment)
    fitted: GelScale | None = None


def _scale_of(presses: PressFolder, known: tuple[float, float] | None) -> Scale:
    """Return the known scale, else that of the presses with known moves, else a DIGIT's, with a doubt."""
    if known is not None:
        return Scale(known)
    moved = [p for p in presses.found if p.id in presses.moves_mm]
    if not moved:
        doubt = "mm per px is a DIGIT's nominal 0.06: give --mm-per-px, or x_mm and y_mm in catalog.csv"
        return Scale(NOMINAL_MM_PER_PX, Assessment(doubts=(doubt,)))
    moves = np.array([presses.moves_mm[p.id] for p in moved])
    centres = np.array([rim_centre(p) for p in moved])
    found = fit_scale(moves, centres, np.array([p.radius_mm for p in moved]))
    across, along = (float(v) for v in found.mm_per_px)
    return Scale((across, along), found.assessment, found)


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


def _assess_map(assessment: Assessment, mapped: bool) -> Assessment:
    """Return the doubts of a colour map that is left out; a scale from known moves is valid without it."""
    if mapped:
        return assessment
    return Assessment(doubts=tuple(f"colour map left out: {reason}" for reason in assessment.reasons))


def _assess_look(fit: LookFit) -> Assessment:
    """Assess the look by held-out colour errors and by the fields without a press."""
    assessment = limits(
        (100.0 * fit.error_share, 60.0, 90.0,
         "presses left out are rendered with {value:.0f} % of their colour change wrong: press more places"),
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


def _assess_light(fit: BallFit, background: Image) -> Assessment:
    """Return dark or saturated colours as the reason for a failed or doubtful map."""
    dark = float((background.min(axis=2) < _DARK_GREY).mean())
    bright = float((background.max(axis=2) >= SATURATED).mean())
    text = (
        f"in {dark:.0%} of the picture a colour has less than {_DARK_GREY:.0f} grey levels, and in "
        f"{bright:.0%} one is saturated: there slopes hardly change it; change the exposure or the LEDs' "
        "intensity, or press this unit more often"
    )
    lost = dark + bright > _LOST_SHARE
    if fit.assessment.refusals and (lost or fit.null_rms >= NULL_REFUSED):
        return Assessment((text,))
    return Assessment(doubts=(text,) if lost else ())


def _assess_background(background: Image, look: LookFit) -> Assessment:
    """Compare the background with the untouched parts of all presses, which shows a contact in it."""
    still = Reference(background.astype(np.float32), 0.0, float((background >= SATURATED).mean()), 0)
    touched = assess_reference(still, drift_since(still, look.look.background))
    if touched.reasons:
        cure = "background: take it again if anything touched the gel; give 30 frames without contact"
        touched += Assessment(doubts=(f"{cure} with --untouched",))
    return touched


def _figures_of_scale(scale: Scale) -> list[Figure]:
    found, label = scale.fitted, "scale along x, y"
    if found is None:
        return [Figure("mm_per_px", scale.mm_per_px, label, ".5f", "mm per px", top=True)]
    return [
        Figure("mm_per_px", scale.mm_per_px, label, ".5f", "mm per px", sigma=found.sigma, top=True),
        Figure("pixel_aspect", found.pixel_aspect, "pixel, width over height", ".4f",
               sigma=found.aspect_sigma, top=True),
        Figure("moves_missed_px", found.residual_px),
    ]  # fmt: skip


def _figures(fit: BallFit, look_fit: LookFit) -> list[Figure]:
    """Return the figures of the colour map and of the look."""
    look, held_out = look_fit.look, look_fit.held_out
    errors = {f"ball of {2 * radius:g} mm": error for radius, error in fit.radius_error().items()}
    measured = {
        "from their circles": [p.rms_grey for p in held_out],
        "circles adjusted": [p.adjusted_grey for p in held_out],
        "of a change of": [p.change_grey for p in held_out],
    }
    rms_grey = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in measured.items()}
    terms = [f"place to degree {look.place_degree}"]
    terms += ["local background"] if look.by_background else []
    terms += ["light lost beside a dent"] if look.shadows else []
    median, worst, place_px = visibility(look)
    quality = "no compression found" if look.jpeg_quality is None else look.jpeg_quality
    shows = "sigma of the noise by which a slope of 0.1 changes a colour, in the direction that shows least"
    return [
        Figure("radius_error", errors, "error in radius of balls left out (median)", "+.1f", "%", 100.0),
        Figure("held_out_radius_mm", fit.held_out_mm),
        Figure("null_rms", fit.null_rms, "slope where nothing touches", ".4f"),
        Figure("normal_rms_held_out", fit.normal_rms, "error of a normal's part, left out", ".4f"),
        Figure("look_error_share", look_fit.error_share),
        Figure("look_held_out_grey", {p.id: p.rms_grey for p in held_out}),
        Figure("look_held_out_adjusted_grey", {p.id: p.adjusted_grey for p in held_out}),
        Figure("colour_change_grey", {p.id: p.change_grey for p in held_out}),
        Figure("", rms_grey, "look, colour error of presses left out", ".1f", "grey"),
        Figure("", ", ".join(terms), "look, terms that presses left out support"),
        Figure("noise_grey", look.noise.sigma_grey, "noise (R, G, B)", ".1f", "grey"),
        Figure("", {"median": median, "worst": worst}, shows, ".1f"),
        Figure("", place_px, "x, y where a slope shows least", ".0f", "px"),
        Figure("", quality, "JPEG quality"),
    ]  # fmt: skip


def _pictures(fit: BallFit, presses: PressFolder, scale: GelScale | None) -> list[Picture]:
    """Draw the presses and, if their moves are known, the residuals of the scale on the untouched gel."""
    rows, columns = fit.map.shape
    pictures = []
    if scale is not None:
        grey, vectors = cv2.cvtColor(presses.background, cv2.COLOR_RGB2GRAY), -scale.missed_px
        text = "Each arrow points from the position of a contact by motion and scale to the measured one."
        pictures.append(
            charts.residuals(
                "Residuals of the scale", text, scale.centres_px - vectors, vectors, grey.shape[::-1],
                np.asarray(grey, np.uint8),
            )
        )  # fmt: skip
    places = {}
    for radius in sorted(set(fit.true_mm.values())):
        x, y = np.array([fit.centres_px[i] for i, true in fit.true_mm.items() if true == radius]).T
        places[f"{2 * radius:g} mm"] = x, rows - y
    press = max(presses.found, key=lambda p: float(p.strength.max()))
    x, y = np.meshgrid(np.arange(0, columns, 2), np.arange(0, rows, 2))
    at = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    slopes = fit.map.slopes(press.change[y.ravel(), x.ravel()], at)[:, 0].reshape(x.shape)
    balls = {i: 2 * fit.held_out_mm[i] for i in fit.true_mm}
    of_balls = "Estimated by the colour map that was fitted to the other presses."
    of_places = "The colour map is not fitted where no ball was pressed."
    of_slopes = f"{press.id}: the slope dz/dx that the colour map estimates."
    return [
        *pictures,
        charts.bars("Ball diameter of each press left out", of_balls, balls, "diameter, mm"),
        charts.curves("Where the balls were pressed", of_places, places, "x, px", "up, px", "."),
        charts.field("Slopes of one press", of_slopes, slopes, (columns, rows), "dz/dx"),
    ]


def collect_tactile(station: Station, options: TactileOptions) -> list[CalibrationResult]:
    """Press balls several times each; without balls take frames at rest.

    Raises as `collect_presses` and `collect_references` do.
    """
    balls_mm = options.balls_mm
    return collect_presses(station, balls_mm, options.presses) if balls_mm else collect_references(station)


def collect_references(station: Station) -> list[CalibrationResult]:
    """Take thirty frames of every fingertip, untouched; nothing moves.

    The mean picture is kept as `tactile-reference-<serial>.png`; one kept earlier is compared with.
    Raises `DeviceError`, `CalibrationError` for a sensor that is touched, dark or frozen.
    """
    results = []
    introduction = "Nothing moves; the fingertips take frames without contact."
    with station.connection(introduction, asks=False) as (bench, _):
        for tip in bench.fingertips:
            frames = [frame.image for frame in capture_still(bench, tip.sensor, _FRAMES, station.show)]
            serial = tip.sensor.serial
            simulated = station.config.gives_simulated(serial)
            results.append(_reference_result(make_reference(frames), serial, station.folder, simulated))
            station.note(f"{serial}: frames taken", len(results), len(bench.fingertips))
    return results


def collect_presses(station: Station, balls_mm: Sequence[float], count: int) -> list[CalibrationResult]:
    """Press each ball at `count` places of both gels at once, and solve for scale and colour map.

    The arm moves the contact over the gels by known steps; so the scale along x and y needs no
    ruler. Raises `InputError` for balls the fingers cannot take, `OperatorStopError`, `DeviceError`.
    """
    config = station.config
    require_parts(config, "rig calibrate tactile --ball-mm")
    if min(balls_mm) < 2.0 or max(balls_mm) > 30.0:
        raise InputError(
            f"balls of {list(balls_mm)} mm: diameters of 2 to 30 mm make a print of a gel's size"
        )
    folders = {tip.serial: station.raw(f"tactile-{tip.serial}") for tip in config.tactile}
    rows: dict[str, list[str]] = {tip.serial: [] for tip in config.tactile}
    touches = [touch for mm in balls_mm for touch in _places(config, mm, count, station.seed)]
    mark_m = config.require("table").position_m
    with station.connection(
        f"The fingers will close gently on a ball on its post, {count} times for each of "
        f"{len(balls_mm)} balls, up to {max(_REACH_MM):.0f} mm from its middle, at most "
        f"{1e3 * _GRIP_M[1]:.1f} mm past contact.",
        from_home=True,
        motions=touch_motions(config, touches),
    ) as (bench, operator):
        watch = TouchObserver(tuple(folders), shown=station.show)

        def keep(touch: Touch) -> None:
            right, _, up = 1e3 * np.subtract(touch.base_T_grasp.position_m, mark_m)
            for tip in config.tactile:
                folder, untouched = folders[tip.serial], watch.reference[tip.serial]
                picture, background = f"{touch.id}.png", f"untouched-{touch.id}.png"
                write_picture(folder / picture, watch.newest[tip.serial].image)
                write_picture(folder / background, untouched)
                if not (folder / "background.png").exists():
                    write_picture(folder / "background.png", untouched)
                at = f"{-tip.sign * right:.4f},{up:.4f}"
                rows[tip.serial].append(f"{picture},{1e3 * touch.width_m:g},{at},{background}")
            pressed = len(rows[config.tactile[0].serial])
            station.note(f"{touch.id}: pressed", pressed, len(touches))

        capture_presses(bench, operator, watch, touches, keep)
    for serial, folder in folders.items():
        write_table(folder / "catalog.csv", _CATALOG, rows[serial])
    return [
        replace(solve_tactile(Samples(folder), TactileOptions(serial=serial)), simulated=config.simulated)
        for serial, folder in folders.items()
    ]


def _places(config: BenchConfig, ball_mm: float, count: int, seed: int) -> list[Touch]:
    """Return places spread over the gels, pressed more and less deep."""
    rng = np.random.default_rng((seed, 33, round(100 * ball_mm)))
    first = rng.uniform()
    spec = config.gripper_spec()
    lightest, firmest = map(spec.steps_for, _GRIP_M)
    touches = []
    for i in range(count):
        # a Fibonacci lattice: along the gel step by step, across it by the golden ratio
        x, z = 2.0 * ((first + i * _GOLDEN) % 1.0) - 1.0, 2.0 * (i + 0.5) / count - 1.0
        pose = grasp_at(config, 1e-3 * float(x) * _REACH_MM[0], 1e-3 * float(z) * _REACH_MM[1])
        grip_m = int(rng.integers(lightest, firmest + 1)) * spec.resolution_m
        name = f"ball of {ball_mm:g} mm on its post"
        touches.append(Touch(f"{ball_mm:g}-{i:02d}", f"ball:{ball_mm:g}", name, pose, ball_mm / 1e3, grip_m))
    return touches


def _reference_result(reference: Reference, serial: str, folder: Path, simulated: bool) -> CalibrationResult:
    path = folder / f"tactile-reference-{serial}.png"
    drift = None
    if path.exists():
        earlier = load_image(path)
        if earlier is None:
            raise CalibrationError(f"{path}: the earlier reference cannot be read; remove it to start again")
        drift = drift_since(reference, earlier.astype(np.float32))
    assessment, mean = assess_reference(reference, drift), np.rint(reference.image).astype(np.uint8)
    if not assessment.refusals:
        write_picture(path, mean)
    rows, columns = mean.shape[:2]
    found = [
        Figure("noise_grey", reference.noise_grey, "noise", ".2f", "grey"),
        Figure("saturated", reference.saturated, "saturated", ".2f", "%", 100.0),
        Figure("hot_pixels", reference.hot_pixels),
    ]
    if drift is not None:
        gain = drift.gain if np.isfinite(drift.gain).all() else None
        found += [
            Figure("light_gain", gain, "light since the earlier reference (R, G, B)", ".3f"),
            Figure("changed_share", drift.contact_share, "picture that changed shape", ".2f", "%", 100.0),
            Figure("moved_px", drift.moved_px),
        ]
    return CalibrationResult(
        "tactile", {"tactile": serial},
        {"image_height": rows, "image_width": columns, "reference_image": path.name}, assessment,
        found, source=f"{_FRAMES} frames at rest", used=_FRAMES,
        files=[path] if path.exists() else [], simulated=simulated, part="reference",
        pictures=[charts.image("Reference", "The mean of the frames.", mean)],
    )  # fmt: skip


TACTILE = Kind("tactile", TactileOptions, "samples", solve_tactile, collect_tactile)
