"""`rig calibrate gripper, sync`: tables and streams from a folder."""

from dataclasses import replace
from pathlib import Path

from calibration.opening import STEP_M, Direction, OpeningSample, calibrate_opening
from calibration.time_offset import TimeOffset, time_offset
from calibration.timed_signal import TimedSignal
from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.formats import number_in, read_csv_rows
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture
from rig.calibrate.sources import read_stream


def gripper_from_folder(folder: Path, serial: str, step_m: float = STEP_M) -> CalibrationResult:
    """Calibrate the opening from gripper.csv: counts, opening_mm, direction (closing, opening).

    step_m: change of this gripper's opening per count, against which the unit of the table is checked.
    """
    path = folder / "gripper.csv"
    samples = []
    for line, row in read_csv_rows(path, ("counts", "opening_mm", "direction")):
        where, way = f"{path} line {line}", row["direction"]
        if way not in list(Direction):
            raise InputError(f"{where}: direction '{way}' is neither closing nor opening")
        counts, opening_m = number_in(row, "counts", where), number_in(row, "opening_mm", where) / 1e3
        samples.append(OpeningSample(f"line {line}", counts, opening_m, Direction(way)))
    result = calibrate_opening(samples, step_m)
    numbers, curves = {}, {}
    for way, table in result.tables.items():
        counts, opening_mm = table.counts, 1e3 * table.opening_m
        curves[str(way)] = counts, opening_mm
        ends_mm = f"{opening_mm[-1]:.1f} to {opening_mm[0]:.1f} mm"
        numbers[str(way)] = f"{counts[0]:g} to {counts[-1]:g} counts, {ends_mm}"
    if result.hysteresis_m is not None:
        numbers["hysteresis"] = f"{1e3 * result.hysteresis_m:.2f} mm"
    text = (
        "As measured, monotone in each direction, not extrapolated. The bench uses that of closing fingers."
    )
    used = result.tables.get(Direction.CLOSING)
    return CalibrationResult(
        "gripper",
        {"gripper": serial},
        result.assessment,
        str(folder),
        {"closing": {"counts": used.counts, "opening_m": used.opening_m}} if used else {},
        {} if result.hysteresis_m is None else {"hysteresis_m": result.hysteresis_m},
        numbers,
        len(samples) - len(result.rejected),
        result.rejected,
        [path],
        [
            Picture(
                "Opening over counts",
                text,
                figures.curves(curves, "gripper position, counts", "opening, mm", "o-"),
            )
        ]
        if curves
        else [],
    )


def sync_from_folder(folder: Path, first: str, second: str, search_s: float) -> CalibrationResult:
    """Two CSV files of one motion, `<name>.csv` with time_ns (or t_s) and value."""
    paths = [folder / f"{name}.csv" for name in (first, second)]
    one, other = (read_stream(path) for path in paths)
    found = time_offset(one, other, search_s)
    quality = {
        "sigma_s": found.sigma_s,
        "drift_sigma_ppm": found.drift_sigma_ppm,
        "explained": found.explained,
    }
    result = CalibrationResult(
        "sync",
        {"reference": first, "stream": second},
        found.assessment,
        str(folder),
        quality={name: value for name, value in quality.items() if value is not None},
        used=found.used,
        files=paths,
    )
    return result if found.offset_s is None else _with_offset(result, found, found.offset_s, one, other)


def _with_offset(
    result: CalibrationResult, found: TimeOffset, offset_s: float, one: TimedSignal, other: TimedSignal
) -> CalibrationResult:
    """Add the offset, its figures, and both streams on one time axis."""
    first, second = result.serials.values()
    numbers = {
        "to add to the stream": f"{1e3 * offset_s:.3f} ± {1e3 * (found.sigma_s or 0.0):.3f} ms",
        "motion explained": f"{found.explained:.1%}",
    }
    if found.drift_ppm is not None:
        numbers["drift of the clocks"] = (
            f"{found.drift_ppm:.2f} ± {found.drift_sigma_ppm:.2f} ppm; the bench uses the offset alone"
        )
    zero = one.time_ns[0]
    shown = {
        first: ((one.time_ns - zero) / NS_PER_S, one.values - one.values.mean()),
        f"{second}, moved": (
            (other.time_ns - zero) / NS_PER_S + offset_s,
            (other.values - other.values.mean()) / (found.gain or 1.0),
        ),
    }
    text = "The second is shifted by the offset and scaled; both should coincide."
    return replace(
        result,
        value={
            "reference": first,
            "stream": second,
            "add_to_stream_s": offset_s,
            "drift_ppm": found.drift_ppm,
        },
        numbers=numbers,
        pictures=[Picture("Both streams", text, figures.curves(shown, "time, s", "value without its mean"))],
    )
