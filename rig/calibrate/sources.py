"""Samples from a folder: pictures, robot poses, streams, tables; paired by name, never by order."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.poses import pose_from_quaternion, pose_from_rotation_vector
from calibration.timed_signal import TimedSignal, make_stream, turning_rate
from calibration.verdict import Rejected
from drivers.errors import CalibrationError, InputError
from drivers.formats import read_csv_rows, reason, shown
from drivers.images import SUFFIXES
from drivers.types import Pose

_LONGEST_WHOLE = 20
"""Characters of a whole number of 64 bits."""


def picture_files(folder: Path, pattern: str = "*") -> list[Path]:
    """Pictures of a folder, by name. Raises `InputError` for a folder without any."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; --from takes the folder of the samples")
    found = sorted(p for p in folder.glob(pattern) if p.suffix.lower() in SUFFIXES)
    if not found:
        raise InputError(f"{folder}: no pictures named {pattern} here ({', '.join(SUFFIXES)})")
    return found


def read_poses(path: Path) -> tuple[dict[str, Pose], list[Rejected]]:
    """`base_T_tcp` by id, from a CSV: id, x_m, y_m, z_m and qx, qy, qz, qw or rx_rad, ry_rad, rz_rad (UR).

    Rows that hold no valid pose are left out, with their reason. Raises `InputError` for the file itself.
    """
    rows = read_csv_rows(path, ("id", "x_m", "y_m", "z_m"))
    poses: dict[str, Pose] = {}
    rejected: list[Rejected] = []
    for line, row in rows:
        name = row["id"]
        try:
            if name in poses:
                raise CalibrationError(f"line {line}: the id {name} a second time")
            poses[name] = _pose(row, f"line {line}")
        except CalibrationError as error:
            rejected.append(Rejected(name, str(error)))
    return poses, rejected


def read_stream(path: Path) -> TimedSignal:
    """A stream from a CSV: time_ns (or t_s), and value or an orientation, qx, qy, qz, qw, that turns.

    Raises `InputError`, `CalibrationError`.
    """
    rows = [row for _, row in read_csv_rows(path, ())]
    if rows and "time_ns" not in rows[0] and "t_s" not in rows[0]:
        raise InputError(f"{path}: has no column time_ns or t_s")
    try:
        if rows and "time_ns" in rows[0]:
            times = np.array([_whole(row["time_ns"]) for row in rows], np.int64)
        else:
            times = np.array([_nanoseconds(row["t_s"]) for row in rows], np.int64)
        if rows and "value" not in rows[0] and "qw" in rows[0]:
            turns = np.array([[float(row[name]) for name in ("qx", "qy", "qz", "qw")] for row in rows])
            return turning_rate(times, turns, path.name)
        values = np.array([float(row["value"]) for row in rows])
    except (KeyError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: a time or value is not a number ({reason(error)})") from error
    return make_stream(times, values, path.name)


def number(row: dict[str, str], column: str, where: str) -> float:
    """A number of a row. Raises `InputError` naming line and column."""
    try:
        value = float(row[column])
        if not math.isfinite(value):
            raise ValueError
        return value
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{where}: column {column} holds {shown(row.get(column))}, which is not a number"
        ) from error


def _nanoseconds(text: str) -> int:
    """Decimal seconds to ns, without the rounding of a float."""
    whole, _, part = text.strip().partition(".")
    sign = -1 if whole.startswith("-") else 1
    return _whole(whole or "0") * 10**9 + sign * int((part + "0" * 9)[:9] or "0")


def _whole(text: str) -> int:
    if len(text) > _LONGEST_WHOLE:
        raise ValueError(f"{shown(text)} is beyond 64 bits")
    return int(text)


def _pose(row: dict[str, str], where: str) -> Pose:
    def read(*names: str) -> NDArray[np.float64]:
        try:
            return np.array([float(row[name]) for name in names])
        except (KeyError, ValueError) as error:
            raise CalibrationError(f"{where}: a number is missing or damaged") from error

    position = read("x_m", "y_m", "z_m")
    if "qw" in row:
        return pose_from_quaternion(position, read("qx", "qy", "qz", "qw"), where)
    if "rx_rad" in row:
        return pose_from_rotation_vector(position, read("rx_rad", "ry_rad", "rz_rad"), where)
    raise CalibrationError(f"{where}: no orientation; qx, qy, qz, qw or rx_rad, ry_rad, rz_rad are needed")
