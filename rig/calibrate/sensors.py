"""`rig calibrate markers, tactile`: still marker pictures, and ball presses, from a folder."""

from pathlib import Path

import numpy as np

from calibration.gel.balls import BallFit, BallPress, calibrate_gel
from calibration.gel.presses import Press, find_press
from calibration.gel.reference import Reference, judge_reference
from calibration.marker_angle import MarkerAngle, assess_markers
from calibration.planar import Intrinsics
from calibration.verdict import Judgement, Rejected
from drivers.errors import CalibrationError, InputError
from rig.calibrate import figures
from rig.calibrate.outcome import Outcome, Picture, Thumbnail
from rig.calibrate.sources import number, picture_files, read_grey, read_rgb, read_table


def markers_from_folder(
    folder: Path,
    pattern: str,
    ids: tuple[int, int],
    dictionary: str,
    intrinsics: Intrinsics | None,
    serial: str,
) -> Outcome:
    """How well the angle is known, from twenty pictures of the markers at rest. Raises `CalibrationError`."""
    files = picture_files(folder, pattern)
    pictures = [read_grey(path) for path in files]
    report = assess_markers(pictures, MarkerAngle(ids, dictionary, intrinsics))
    plane = report.plane
    value = {
        "dictionary": dictionary,
        "ids": ids,
        "side_px": plane.side_px,
        "tilt_deg": plane.tilt_deg,
        "angle_sigma_deg": report.sigma_deg,
    }
    quality = {
        "corner_scatter_px": plane.scatter_px,
        "square_fit_px": plane.fit_px,
        "drift_deg": report.drift_deg,
        "refused_pictures": report.refused,
        "plane_T_image": plane.plane_T_image[0],
    }
    numbers = {
        "side": f"{plane.side_px:.1f} px",
        "tilt to the camera": "unknown without intrinsics"
        if plane.tilt_deg is None
        else f"{plane.tilt_deg:.1f} degrees",
        "angle at rest, one sigma": f"{report.sigma_deg:.4f} degrees",
        "drift": f"{report.drift_deg:+.4f} degrees",
    }
    shown = figures.lines(
        {"angle": (np.arange(float(len(report.rest_deg))), report.rest_deg)}, "picture", "degrees"
    )
    return Outcome(
        "markers",
        {"camera": serial},
        value,
        quality,
        report.judgement,
        numbers,
        str(folder),
        len(files),
        (),
        files,
        [Picture("Angle at rest", "It should scatter round zero, without a trend.", shown)],
        [Thumbnail("first picture", "", figures.thumbnail(pictures[0]))],
    )


def tactile_from_folder(folder: Path, serial: str, mm_per_px: tuple[float, float]) -> Outcome:
    """background.png and catalog.csv (image, diameter(mm)) with its pictures: the gel's colour map."""
    reference = read_rgb(folder / "background.png").astype(np.float32)
    path = folder / "catalog.csv"
    rows = read_table(path, ("image", "diameter(mm)"))
    presses: list[BallPress] = []
    rejected: list[Rejected] = []
    for line, row in enumerate(rows, start=2):
        radius = number(row, "diameter(mm)", f"{path} line {line}") / 2.0
        picture = folder / row["image"]
        if not picture.is_file():
            raise InputError(f"{path} line {line}: {row['image']} is not in {folder}")
        found = find_press(read_rgb(picture), reference, row["image"])
        if isinstance(found, str):
            rejected.append(Rejected(row["image"], found))
        else:
            presses.append(BallPress(found, radius))
    return _tactile(folder, serial, presses, rejected, reference, mm_per_px)


def _tactile(
    folder: Path,
    serial: str,
    presses: list[BallPress],
    rejected: list[Rejected],
    reference: np.ndarray,
    mm_per_px: tuple[float, float],
) -> Outcome:
    still = Reference(reference, 0.0, float((reference >= 250).mean()), 0, 1)
    thumbs = [Thumbnail(r.id, r.reason, figures.thumbnail(read_rgb(folder / r.id))) for r in rejected]
    files = [folder / "background.png", folder / "catalog.csv"]
    try:
        result = calibrate_gel(presses, mm_per_px)
    except CalibrationError as error:
        judged = Judgement((str(error),))
        return Outcome(
            "tactile", {"tactile": serial}, {}, {}, judged, {}, str(folder), 0, rejected, files, (), thumbs
        )
    rows, columns = result.map.shape
    value = {
        "image_height": rows,
        "image_width": columns,
        "mm_per_px": mm_per_px,
        "gradient_map": {
            "features": "log colour change x place, calibration.gel.gradient_map",
            "weights": result.map.weights,
        },
    }
    quality = {
        "normal_rms_held_out": result.normal_rms,
        "null_rms": result.null_rms,
        "held_out_radius_mm": result.held_out_mm,
        "radius_error": {f"{r:g} mm": e for r, e in result.radius_error().items()},
    }
    numbers = {
        f"balls of {2 * r:g} mm, left out": f"{100 * e:+.1f} % in radius (median)"
        for r, e in result.radius_error().items()
    }
    numbers["slope where nothing touches"] = f"{result.null_rms:.4f}"
    numbers["error of a normal's part, left out"] = f"{result.normal_rms:.4f}"
    return Outcome(
        "tactile",
        {"tactile": serial},
        value,
        quality,
        result.judgement + judge_reference(still),
        numbers,
        str(folder),
        len(result.true_mm),
        [*rejected, *result.rejected],
        files,
        _pictures(result, presses),
        thumbs,
    )


def _pictures(result: BallFit, presses: list[BallPress]) -> list[Picture]:
    groups = {}
    for radius in sorted(set(result.true_mm.values())):
        names = [i for i, true in result.true_mm.items() if true == radius]
        groups[f"{2 * radius:g} mm"] = np.array([result.centres_px[i] for i in names])
    rows, columns = result.map.shape
    places = {name: (c[:, 0], rows - c[:, 1]) for name, c in groups.items()}
    press = max((p.press for p in presses), key=lambda p: float(p.strength.max()))
    radii = {i: 2 * result.held_out_mm[i] for i in result.true_mm}
    return [
        Picture(
            "Ball diameter of each press left out",
            "As the map of the others says it.",
            figures.bars(radii, "mm"),
        ),
        Picture(
            "Where the balls were pressed",
            "Gaps are where the map is not known.",
            figures.scatter(places, "x, px", "up, px"),
        ),
        Picture(
            "Slopes of one press",
            f"{press.id}: dz/dx as the map sees it.",
            _slope_picture(press, result, columns, rows),
        ),
    ]


def _slope_picture(press: Press, result: BallFit, columns: int, rows: int) -> bytes:
    x, y = np.meshgrid(np.arange(0, columns, 2), np.arange(0, rows, 2))
    places = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    slopes = result.map.slopes(press.change[y.ravel(), x.ravel()], places)
    return figures.field(slopes[:, 0].reshape(x.shape), (columns, rows), "dz/dx")
