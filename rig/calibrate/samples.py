"""Samples in a folder: pictures, robot poses, streams, tables; paired by name, never by order."""

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.poses import pose_from_quaternion, pose_from_rotation_vector
from calibration.store import write_bytes
from calibration.time_offset import TimedSignal, make_stream, turning_rate
from calibration.verdict import Rejected
from drivers.errors import CalibrationError, FormatError, InputError
from drivers.formats import number_in, quote, read_csv_rows, read_json, time_ns_in, whole_in
from drivers.images import SUFFIXES, encode_png, images_in_order
from drivers.types import Image, Pose
from rig.version import version_text

QUATERNION = ("qx", "qy", "qz", "qw")
ORIGIN = "origin.json"
"""File beside samples that were taken on a bench: whether they are simulated, bench, code and time."""


def write_origin(folder: Path, bench: str, simulated: bool) -> None:
    """Write where the samples of a folder come from; a calibration `--from` them keeps the mark."""
    taken = datetime.now(UTC).isoformat(timespec="seconds")
    about = {"simulated": simulated, "bench": bench, "rig": version_text(), "taken": taken}
    write_bytes(folder / ORIGIN, f"{json.dumps(about)}\n".encode())


def has_simulated_samples(folder: Path) -> bool:
    """Whether the samples of a folder say that they are simulated. Raises `InputError` for a damaged file."""
    path = folder / ORIGIN
    if not path.is_file():
        return False
    try:
        return bool(read_json(path)["simulated"])
    except (FormatError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: cannot be read, so it is unknown whether these samples are simulated; write "
            '{"simulated": true} or {"simulated": false} into it'
        ) from error


def picture_files(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the pictures of a folder, see `images_in_order`. Raises `InputError` if there are none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; --from takes the folder of the samples")
    found = images_in_order(folder.glob(pattern))
    if not found:
        raise InputError(f"{folder}: no pictures named {pattern} here ({', '.join(SUFFIXES)})")
    return found


def read_poses(path: Path, child_frame: str = "") -> tuple[dict[str, Pose], list[Rejected]]:
    """Read poses from a CSV: id, x_m, y_m, z_m and qx, qy, qz, qw or rx_rad, ry_rad, rz_rad (UR).

    child_frame: the frame whose poses are needed; "" for any. Rows that hold no valid pose are left out, with
    their reason. Raises `InputError` for the file itself, also if its column child_frame names another frame.
    """
    rows = read_csv_rows(path, ("id", "x_m", "y_m", "z_m"))
    others = {row.get("child_frame", "") for _, row in rows} - {"", child_frame}
    if child_frame and others:
        raise InputError(
            f"{path}: its column child_frame says {', '.join(map(quote, sorted(others)))}, and base_T_tcp is "
            f"needed: convert the poses, and write '{child_frame}' in it"
        )
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
    """Read a stream from a CSV: time_ns (or t_s), and value or an orientation, qx, qy, qz, qw, that turns.

    Its resolution is at least that of the digits of t_s. Raises `InputError`, `CalibrationError`.
    """
    rows = [(row, f"{path}: line {line}") for line, row in read_csv_rows(path, ())]
    columns = rows[0][0] if rows else {"time_ns": ""}
    if "time_ns" not in columns and "t_s" not in columns:
        raise InputError(f"{path}: has no column time_ns or t_s")
    digits_s = 0.0
    if "time_ns" in columns:
        times = np.array([whole_in(row, "time_ns", where) for row, where in rows], np.int64)
    else:
        times = np.array([time_ns_in(row, "t_s", where) for row, where in rows], np.int64)
        digits_s = 10.0 ** min(0, *(int(Decimal(row["t_s"]).as_tuple().exponent) for row, _ in rows))
    if "value" not in columns and "qw" in columns:
        turns = [[number_in(row, name, where) for name in QUATERNION] for row, where in rows]
        stream = turning_rate(times, np.array(turns), path.name)
    else:
        values = np.array([number_in(row, "value", where) for row, where in rows])
        stream = make_stream(times, values, path.name)
    return replace(stream, resolution_s=max(stream.resolution_s, digits_s))


def _pose(row: dict[str, str], where: str) -> Pose:
    def read(*names: str) -> NDArray[np.float64]:
        try:
            return np.array([number_in(row, name, where) for name in names])
        except FormatError as error:
            raise CalibrationError(str(error)) from error

    position = read("x_m", "y_m", "z_m")
    if "qw" in row:
        return pose_from_quaternion(position, read(*QUATERNION), where)
    if "rx_rad" in row:
        return pose_from_rotation_vector(position, read("rx_rad", "ry_rad", "rz_rad"), where)
    raise CalibrationError(f"{where}: no orientation; qx, qy, qz, qw or rx_rad, ry_rad, rz_rad are needed")


def write_picture(path: Path, image: Image) -> None:
    """Write a picture, (H, W) or (H, W, 3) uint8 RGB, as PNG. Raises `RecordingError`."""
    write_bytes(path, encode_png(image))


def write_table(path: Path, header: str, rows: Sequence[str]) -> None:
    write_bytes(path, ("\n".join([header, *rows]) + "\n").encode())


def pose_row(name: str, pose: Pose) -> str:
    return ",".join([name, *(f"{v:.12g}" for v in (*pose.position_m, *pose.quaternion_xyzw))])


def write_poses(folder: Path, rows: Sequence[str], child_frame: str) -> None:
    """Write poses.csv as `--from` reads it. child_frame: "tcp" for base_T_tcp, "flange" for base_T_flange."""
    header = "id,x_m,y_m,z_m,qx,qy,qz,qw,child_frame"
    write_table(folder / "poses.csv", header, [f"{row},{child_frame}" for row in rows])
