"""The result of a calibration command: a file, a page, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from markupsafe import Markup

from calibration.store import CalibrationFile, plain, save, write_text
from calibration.verdict import Assessment, Rejected, Verdict
from drivers.errors import CalibrationError
from rig.pages.page import render


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page: SVG, or a picture's PNG bytes, with what it shows."""

    title: str
    text: str
    shown: Markup | bytes


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A rejected sample as the page shows it; png: None where the sample has no picture."""

    id: str
    reason: str
    png: bytes | None = None


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration before it is filed.

    value, quality: as in the file. numbers: what the page lists first, as text. source: where the
    samples lie. files: the samples, for the hash. part: of the kind, where it has several files.
    """

    kind: str
    serials: Mapping[str, str]
    value: Mapping[str, Any]
    quality: Mapping[str, Any]
    assessment: Assessment
    numbers: Mapping[str, str]
    source: str
    used: int
    rejected: Sequence[Rejected] = ()
    files: Sequence[Path] = ()
    pictures: Sequence[Picture] = ()
    thumbnails: Sequence[Thumbnail] = ()
    simulated: bool = False
    part: str = ""

    def marked(self, simulated: bool) -> "CalibrationResult":
        """A copy that says whether it was made on simulated devices."""
        return replace(self, simulated=simulated)


@dataclass(frozen=True, slots=True)
class Filed:
    """A calibration on disk: its file, its page, and its figures for `--json`."""

    path: Path
    page: Path
    figures: dict[str, object] = field(default_factory=dict)


def file_result(result: CalibrationResult, folder: Path) -> Filed:
    """Write file and page into a folder. Raises `CalibrationError` for a refused one, after writing both."""
    part = [result.part] if result.part else []
    stem = "-".join([result.kind, *part, *result.serials.values()])
    path, page = folder / f"{stem}.yaml", folder / f"{stem}.html"
    filed = _as_file(result)
    save(filed, path)
    write_text(page, _page(result, filed))
    figures = plain(
        {
            "kind": result.kind,
            "file": path,
            "page": page,
            "verdict": str(result.assessment.verdict),
            "reasons": result.assessment.reasons,
            "used": result.used,
            "numbers": result.numbers,
            "rejected": [{"id": r.id, "reason": r.reason} for r in result.rejected],
            "value": result.value,
            "quality": result.quality,
            "simulated": result.simulated,
        },
        str(path),
    )
    if result.assessment.verdict is Verdict.REFUSED:
        reasons = "; ".join(result.assessment.refusals)
        about = ", ".join(f"{role} {serial}" for role, serial in result.serials.items())
        raise CalibrationError(f"{result.kind} calibration, {about}: refused: {reasons} (page: {page})")
    return Filed(path, page, figures)


def _page(result: CalibrationResult, filed: CalibrationFile) -> str:
    """One HTML page that needs nothing else; each picture is inside it as data."""
    return render(
        "rig.calibrate",
        "page.html",
        result=result,
        created=filed.created,
        verdict=str(result.assessment.verdict),
        software=", ".join(f"{name} {number}" for name, number in filed.software.items()),
        inputs=filed.inputs,
    )


def _as_file(result: CalibrationResult) -> CalibrationFile:
    digest = sha256()
    for path in sorted(result.files):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    inputs = {"source": result.source, "used": result.used, "sha256": digest.hexdigest()}
    software = {
        name: version(name) for name in ("visuotactile-slip-rig", "opencv-contrib-python-headless", "numpy")
    }
    return CalibrationFile(
        result.kind,
        result.serials,
        result.value,
        result.assessment,
        datetime.now(UTC).isoformat(timespec="seconds"),
        result.quality,
        tuple(result.rejected),
        inputs | ({"simulated": True} if result.simulated else {}),
        software,
    )
