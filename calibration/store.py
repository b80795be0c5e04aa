"""Calibration files: plain YAML, versioned, with the serials of the devices they belong to.

The value stands at the top level in the layout its field reads (a camera's is ROS `camera_info`);
everything known about the value stands under `calibration`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.verdict import Assessment, Rejected, Verdict
from drivers import formats
from drivers.errors import CalibrationError, FormatError, RecordingError, counted
from drivers.formats import write_whole

SCHEMA = 1
KINDS = ("camera", "hand-eye", "markers", "tactile", "gripper", "tcp", "sync")


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """One calibration.

    kind: one of `KINDS`. serials: of the devices it belongs to, by role ("camera", "tactile").
    value: what is used. quality: covariance, held-out error, observability, by name. created: ISO
    8601 with zone. inputs: hash and place of the samples, and how many were used.
    """

    kind: str
    serials: Mapping[str, str]
    value: Mapping[str, Any]
    assessment: Assessment
    created: str
    quality: Mapping[str, Any] = field(default_factory=dict)
    rejected: tuple[Rejected, ...] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)


def age_days(created: str, now: datetime) -> float:
    """Days since an ISO 8601 time; UTC where it names no zone. Raises `ValueError`."""
    made = datetime.fromisoformat(created)
    return (now - (made if made.tzinfo else made.replace(tzinfo=UTC))).total_seconds() / 86400.0


def age_text(days: float) -> str:
    """An age in words."""
    return f"{days:.0f} days" if days >= 2 else counted(round(max(days, 0.0) * 24), "hour")


def save(file: CalibrationFile, path: Path) -> None:
    """Write a calibration atomically. Raises `RecordingError`, `CalibrationError` for a NaN in it."""
    about = {
        "schema": SCHEMA, "kind": file.kind, "serials": file.serials, "created": file.created,
        "verdict": str(file.assessment.verdict), "refusals": file.assessment.refusals,
        "doubts": file.assessment.doubts, "quality": file.quality,
        "rejected": [{"id": r.id, "reason": r.reason} for r in file.rejected],
        "inputs": file.inputs, "software": file.software,
    }  # fmt: skip
    content = plain({**file.value, "calibration": about}, str(path))
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=110, allow_unicode=True)
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, and its folder, whole or not at all. Raises `RecordingError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error


def load(
    path: Path, kind: str, serials: Mapping[str, str] | None = None, allow_refused: bool = False
) -> CalibrationFile:
    """Read a calibration of a kind.

    serials: of the devices at hand; a file that names others is refused. Raises `CalibrationError`
    saying what is wrong with the file, or which device it belongs to.
    """
    content = read_yaml(path)
    about = content.pop("calibration", None)
    if not isinstance(about, dict) or about.get("schema") != SCHEMA:
        raise CalibrationError(f"{path}: no calibration file of schema {SCHEMA}; make it with rig calibrate")
    if about.get("kind") != kind:
        raise CalibrationError(f"{path}: holds a calibration of '{about.get('kind')}', '{kind}' is needed")
    try:
        file = _from_about(about, content)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        why = f"{type(error).__name__}: {formats.reason(error)}"
        raise CalibrationError(f"{path}: damaged ({why}); make it again with rig calibrate") from error
    check_serials(path, file.serials, serials or {})
    if file.assessment.verdict is Verdict.REFUSED and not allow_refused:
        raise CalibrationError(f"{path}: was refused when it was made ({file.assessment.reasons[0]})")
    return file


def check_serials(path: Path, written: Mapping[str, str], at_hand: Mapping[str, str]) -> None:
    """Raise `CalibrationError` where a device at hand is not the one of the file."""
    for role, serial in at_hand.items():
        if written.get(role) != serial:
            raise CalibrationError(
                f"{path}: belongs to {role} {written.get(role, '(none named)')}, the bench has {serial}; "
                "calibrate this one, or correct the bench file"
            )


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping, OpenCV's dialect included. Raises `CalibrationError`."""
    try:
        content = formats.read_yaml(path)
    except FormatError as error:
        raise CalibrationError(str(error)) from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: holds no mapping; is this a calibration file?")
    return content


def plain(value: Any, where: str) -> Any:
    """Turn arrays, numpy numbers and tuples into plain lists and numbers.

    Raises `CalibrationError` for a number that is not finite: a file never holds a NaN.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{where}: {key}") for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), where)
    if isinstance(value, list | tuple):
        return [plain(item, where) for item in value]
    if isinstance(value, float | np.floating):
        if not np.isfinite(value):
            raise CalibrationError(f"{where}: a number is not finite; this result is not written")
        return float(value)
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    return str(value) if isinstance(value, Path | Verdict) else value


class _Dumper(yaml.SafeDumper):
    """Numbers on one line, mappings on many."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _numbers_on_one_line(dumper: _Dumper, data: list[Any]) -> yaml.SequenceNode:
    flat = all(isinstance(item, int | float) for item in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flat)


_Dumper.add_representer(list, _numbers_on_one_line)


def _from_about(about: Mapping[str, Any], value: Mapping[str, Any]) -> CalibrationFile:
    return CalibrationFile(
        kind=about["kind"],
        serials={str(k): str(v) for k, v in about["serials"].items()},
        value=value,
        assessment=Assessment(tuple(about["refusals"]), tuple(about["doubts"])),
        created=datetime.fromisoformat(about["created"]).isoformat(),
        quality=_mapping(about, "quality"),
        rejected=tuple(Rejected(str(r["id"]), str(r["reason"])) for r in about.get("rejected", [])),
        inputs=_mapping(about, "inputs"),
        software=_mapping(about, "software"),
    )


def _mapping(about: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = about.get(name, {})
    if not isinstance(value, Mapping):
        raise ValueError(f"'{name}' is no mapping")
    return value
