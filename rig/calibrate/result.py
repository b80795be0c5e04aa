"""What every calibration command ends with: a file, a page, a few lines for people."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calibration.store import CalibrationFile, plain, save, write_text
from calibration.verdict import Assessment, Rejected, Verdict
from drivers.errors import CalibrationError
from rig.pages.page import render


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page: PNG bytes, with what it shows."""

    title: str
    text: str
    png: bytes


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A rejected sample as the page shows it; no picture where the sample is none."""

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
    judgement: Assessment
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
        """The same, marked as SIMULATED or not."""
        return replace(self, simulated=simulated)


@dataclass(frozen=True, slots=True)
class Filed:
    """Where a calibration went, and what it says."""

    path: Path
    page: Path
    figures: dict[str, object] = field(default_factory=dict)


def file_result(outcome: CalibrationResult, folder: Path) -> Filed:
    """Write file and page into a folder. Raises `CalibrationError` for a refused one, after writing both."""
    part = [outcome.part] if outcome.part else []
    stem = "-".join([outcome.kind, *part, *outcome.serials.values()])
    path, page = folder / f"{stem}.yaml", folder / f"{stem}.html"
    filed = _as_file(outcome)
    save(filed, path)
    write_text(page, _page(outcome, filed))
    figures = plain(
        {
            "kind": outcome.kind,
            "file": path,
            "page": page,
            "verdict": str(outcome.judgement.verdict),
            "reasons": outcome.judgement.reasons,
            "used": outcome.used,
            "numbers": outcome.numbers,
            "rejected": [{"id": r.id, "reason": r.reason} for r in outcome.rejected],
            "value": outcome.value,
            "quality": outcome.quality,
            "simulated": outcome.simulated,
        },
        str(path),
    )
    if outcome.judgement.verdict is Verdict.REFUSED:
        reasons = "; ".join(outcome.judgement.refusals)
        raise CalibrationError(f"{outcome.kind}: refused: {reasons} (page: {page})")
    return Filed(path, page, figures)


def _page(outcome: CalibrationResult, filed: CalibrationFile) -> str:
    """One HTML page that needs nothing else; each picture is inside it as data."""
    return render(
        "rig.calibrate",
        "page.html",
        outcome=outcome,
        created=filed.created,
        verdict=str(outcome.judgement.verdict),
        software=", ".join(f"{name} {number}" for name, number in filed.software.items()),
        inputs=filed.inputs,
    )


def _as_file(outcome: CalibrationResult) -> CalibrationFile:
    digest = sha256()
    for path in sorted(outcome.files):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    inputs = {"source": outcome.source, "used": outcome.used, "sha256": digest.hexdigest()}
    software = {
        name: version(name) for name in ("visuotactile-slip-rig", "opencv-contrib-python-headless", "numpy")
    }
    return CalibrationFile(
        outcome.kind,
        outcome.serials,
        outcome.value,
        outcome.judgement,
        datetime.now(UTC).isoformat(timespec="seconds"),
        outcome.quality,
        tuple(outcome.rejected),
        inputs | ({"simulated": True} if outcome.simulated else {}),
        software,
    )
