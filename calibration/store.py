"""Read and write calibration files: plain YAML, versioned, with the serials of their devices.

The value is at the top level, in the layout that is usual in its field (for a camera: ROS `camera_info`).
Information about the value is under the key `calibration`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.verdict import Assessment, Rejected, Verdict
from drivers import formats
from drivers.errors import CalibrationError, FormatError, RecordingError, plural
from drivers.formats import write_whole

SCHEMA = 1
"""Version of the layout of calibration files."""
OLD_DAYS = 30.0
"""Age of a calibration from which it should be checked."""


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """One calibration.

    kind: camera, hand-eye, markers, tactile, gripper, tcp or sync. serials: of the devices it belongs to, by
    role ("camera", "tactile"). value: the calibrated value. quality: covariance, held-out error,
    observability, by name. created: ISO 8601 with time zone. inputs: hash and path of the samples, and how
    many were used.
    """

    kind: str
    serials: Mapping[str, str]
    value: Mapping[str, Any]
    assessment: Assessment
    created: str = ""
    quality: Mapping[str, Any] = field(default_factory=dict)
    rejected: Sequence[Rejected] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)


def age_days(created: str, now: datetime) -> float:
    """Return the days since an ISO 8601 time, taken as UTC if it has no zone. Raises `ValueError`."""
    made = datetime.fromisoformat(created)
    return (now - (made if made.tzinfo else made.replace(tzinfo=UTC))).total_seconds() / 86400.0


def age_text(days: float) -> str:
    """Return an age as text: in days, or below two days in hours."""
    return f"{days:.0f} days" if days >= 2 else plural(round(max(days, 0.0) * 24), "hour")


def save(file: CalibrationFile, path: Path) -> None:
    """Write a calibration atomically. Raises `RecordingError`, and `CalibrationError` for NaN or infinity."""
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
    """Write a file atomically, and create its folder. Raises `RecordingError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error


def load(
    path: Path, kind: str, serials: Mapping[str, str] | None = None, allow_refused: bool = False
) -> CalibrationFile:
    """Read a calibration of a kind.

    serials: of the connected devices; a file of other devices is rejected. allow_refused: also return a
    calibration with the verdict refused. Raises `CalibrationError` with what is wrong with the file, or with
    the device that it belongs to.
    """
    content = read_yaml(path)
    about = content.pop("calibration", None)
    if not isinstance(about, dict) or about.get("schema") != SCHEMA:
        named = formats.similar_key(formats.read_text(path, formats.MOST_YAML_BYTES), "calibration")
        raise CalibrationError(
            f"{path}: not a calibration file of schema {SCHEMA}{named}; make it with rig calibrate"
        )
    if about.get("kind") != kind:
        raise CalibrationError(f"{path}: holds a calibration of '{about.get('kind')}', '{kind}' is needed")
    try:
        for name in ("quality", "inputs", "software"):
            if not isinstance(about.get(name, {}), Mapping):
                raise ValueError(f"'{name}' is not a mapping")
        file = CalibrationFile(
            kind=about["kind"],
            serials={str(k): str(v) for k, v in about["serials"].items()},
            value=content,
            assessment=Assessment(tuple(about["refusals"]), tuple(about["doubts"])),
            created=datetime.fromisoformat(about["created"]).isoformat(),
            quality=about.get("quality", {}),
            rejected=tuple(Rejected(str(r["id"]), str(r["reason"])) for r in about.get("rejected", [])),
            inputs=about.get("inputs", {}),
            software=about.get("software", {}),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CalibrationError(
            f"{path}: damaged ({why_damaged(path, error)}); make it again with rig calibrate"
        ) from error
    check_serials(path, file.serials, serials or {})
    if file.assessment.verdict is Verdict.REFUSED and not allow_refused:
        raise CalibrationError(f"{path}: was refused when it was made ({file.assessment.reasons[0]})")
    return file


def why_damaged(path: Path, error: Exception) -> str:
    """Return an error in the content of a calibration file as text: for `KeyError` with a similar key."""
    if not isinstance(error, KeyError):
        return f"{type(error).__name__}: {formats.reason(error)}"
    key = str(error.args[0])
    return f"no '{key}'{formats.similar_key(formats.read_text(path, formats.MOST_YAML_BYTES), key)}"


def check_serials(path: Path, written: Mapping[str, str], at_hand: Mapping[str, str]) -> None:
    """Raise `CalibrationError` if a connected device is not the device of the file."""
    for role, serial in at_hand.items():
        if written.get(role) != serial:
            raise CalibrationError(
                f"{path}: belongs to {role} {written.get(role, '(none named)')}, the bench has {serial}; "
                "calibrate this one, or correct the bench file"
            )


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping, also in OpenCV's dialect. Raises `CalibrationError`."""
    try:
        content = formats.read_yaml(path)
    except FormatError as error:
        raise CalibrationError(str(error)) from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: contains no mapping; is this a calibration file?")
    return content


def plain(value: Any, where: str) -> Any:
    """Convert arrays, numpy numbers and tuples to plain lists and numbers.

    where: name of the value in errors. Raises `CalibrationError` for NaN or infinity, which a calibration
    file never contains.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{where}: {key}") for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), where)
    if isinstance(value, list | tuple):
        return [plain(item, where) for item in value]
    if isinstance(value, float | np.floating):
        if not np.isfinite(value):
            raise CalibrationError(f"{where}: NaN or an infinite value; this result is not written")
        return float(value)
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    return str(value) if isinstance(value, Path | Verdict) else value


class _Dumper(yaml.SafeDumper):
    """Writes lists of numbers on one line, mappings on several lines."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    list,
    lambda dumper, data: dumper.represent_sequence(
        "tag:yaml.org,2002:seq", data, flow_style=all(isinstance(item, int | float) for item in data)
    ),
)
