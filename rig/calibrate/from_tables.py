"""`rig calibrate gripper, sync`: tables and streams from a folder."""

from pathlib import Path

from calibration.fingers.opening import Direction, OpeningSample, calibrate_opening
from calibration.time_offset import time_offset
from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.formats import read_csv_rows
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture
from rig.calibrate.sources import number, read_stream


def gripper_from_folder(folder: Path, serial: str) -> CalibrationResult:
    """Calibrate the opening from gripper.csv: counts, opening_mm, direction (closing, opening)."""
    path = folder / "gripper.csv"
    rows = read_csv_rows(path, ("counts", "opening_mm", "direction"))
    samples = []
    for line, row in rows:
        where = f"{path} line {line}"
        if row["direction"] not in list(Direction):
            raise InputError(f"{where}: direction '{row['direction']}' is neither closing nor opening")
        opening_m = number(row, "opening_mm", where) / 1e3
        samples.append(
            OpeningSample(
                f"line {line}", number(row, "counts", where), opening_m, Direction(row["direction"])
            )
        )
    return _gripper_result(samples, serial, folder)


def _gripper_result(samples: list[OpeningSample], serial: str, folder: Path) -> CalibrationResult:
    result = calibrate_opening(samples)
    value: dict[str, object] = {
        str(way): {"counts": t.counts, "opening_m": t.opening_m, "sigma_m": t.sigma_m}
        for way, t in result.tables.items()
    }
    curves = {str(way): (t.counts, 1e3 * t.opening_m) for way, t in result.tables.items()}
    pictures = (
        [
            Picture(
                "Opening over counts",
                "As measured, monotone each way; nothing beyond its ends.",
                figures.lines(curves, "counts", "opening, mm", marks=True),
            )
        ]
        if curves
        else []
    )
    numbers = {
        f"{way}": f"{t.counts[0]:g} to {t.counts[-1]:g} counts, {1e3 * t.opening_m[-1]:.1f} to "
        f"{1e3 * t.opening_m[0]:.1f} mm"
        for way, t in result.tables.items()
    }
    if result.hysteresis_m is not None:
        numbers["hysteresis"] = f"{1e3 * result.hysteresis_m:.2f} mm"
    quality = {
        k: v
        for k, v in (("hysteresis_m", result.hysteresis_m), ("misfit_m", result.misfit_m))
        if v is not None
    }
    return CalibrationResult(
        "gripper",
        {"gripper": serial},
        value,
        quality,
        result.assessment,
        numbers,
        str(folder),
        len(samples) - len(result.rejected),
        result.rejected,
        [folder / "gripper.csv"],
        pictures,
    )


def sync_from_folder(folder: Path, first: str, second: str, search_s: float) -> CalibrationResult:
    """Two CSV files of one motion, `<name>.csv` with time_ns (or t_s) and value."""
    paths = [folder / f"{name}.csv" for name in (first, second)]
    one, other = (read_stream(path) for path in paths)
    result = time_offset(one, other, search_s)
    value: dict[str, object] = {}
    numbers: dict[str, str] = {}
    pictures = []
    if result.offset_s is not None and result.sigma_s is not None:
        value = {
            "reference": first,
            "stream": second,
            "add_to_stream_s": result.offset_s,
            "drift_ppm": result.drift_ppm,
        }
        numbers = {
            "to add to the stream": f"{1e3 * result.offset_s:.3f} ± {1e3 * result.sigma_s:.3f} ms",
            "motion explained": f"{result.explained:.1%}",
        }
        zero = one.time_ns[0]
        shown = {
            first: ((one.time_ns - zero) / NS_PER_S, one.values - one.values.mean()),
            f"{second}, moved": (
                (other.time_ns - zero) / NS_PER_S + result.offset_s,
                (other.values - other.values.mean()) / (result.gain or 1.0),
            ),
        }
        pictures = [
            Picture(
                "Both streams",
                "The second moved by the offset and scaled: they should lie on each other.",
                figures.lines(shown, "s", "value"),
            )
        ]
    quality = {
        k: v
        for k, v in (
            ("sigma_s", result.sigma_s),
            ("drift_sigma_ppm", result.drift_sigma_ppm),
            ("explained", result.explained),
            ("noise", result.noise),
            ("overlap_s", result.overlap_s),
        )
        if v is not None
    }
    return CalibrationResult(
        "sync",
        {"reference": first, "stream": second},
        value,
        quality,
        result.assessment,
        numbers,
        str(folder),
        result.used,
        (),
        paths,
        pictures,
    )
