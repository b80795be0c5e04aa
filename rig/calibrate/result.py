"""The result of a calibration command: a file, a page, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from markupsafe import Markup

from calibration.store import CalibrationFile, plain, save, write_bytes
from calibration.targets.boards import View
from calibration.verdict import Assessment, Rejected, Verdict
from drivers.errors import CalibrationError
from drivers.images import read_image
from rig.calibrate.figures import thumbnail
from rig.pages.page import render
from rig.version import VERSION


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

    @classmethod
    def of(
        cls, rejected: Rejected, path: Path | None, view: View | str | None = None, grey: bool = True
    ) -> "Thumbnail":
        """Make the thumbnail of a rejected sample; mark its points. Raises `InputError`."""
        marks = [view.image_px] if isinstance(view, View) else []
        png = None if path is None else thumbnail(read_image(path, grey=grey), marks)
        return cls(rejected.id, rejected.reason, png)


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration before it is filed.

    source: folder of the samples. value, quality: as in the file. numbers: the figures at the top of the
    page, as text. used: number of samples. files: the samples, for the hash. part: of the kind, if it has
    several files. attached: content of further files of the same name, by suffix; not written if refused.
    """

    kind: str
    serials: Mapping[str, str]
    assessment: Assessment
    source: str
    value: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)
    numbers: Mapping[str, str] = field(default_factory=dict)
    used: int = 0
    rejected: Sequence[Rejected] = ()
    files: Sequence[Path] = ()
    pictures: Sequence[Picture] = ()
    thumbnails: Sequence[Thumbnail] = ()
    simulated: bool = False
    part: str = ""
    attached: Mapping[str, bytes] = field(default_factory=dict)

    def marked(self, simulated: bool) -> "CalibrationResult":
        """Return a copy with `simulated`: whether it was made on simulated devices."""
        return replace(self, simulated=simulated)


@dataclass(frozen=True, slots=True)
class Filed:
    """A calibration on disk: its file, its page, and its figures for `--json`."""

    path: Path
    page: Path
    figures: dict[str, object]


def file_result(result: CalibrationResult, folder: Path) -> Filed:
    """Write file and page into a folder. Raises `CalibrationError` for a refused one, after writing both."""
    part = [result.part] if result.part else []
    stem = "-".join([result.kind, *part, *result.serials.values()])
    path, page = folder / f"{stem}.yaml", folder / f"{stem}.html"
    filed, verdict = _as_file(result), result.assessment.verdict
    save(filed, path)
    text = render(
        "rig.calibrate",
        "page.html",
        result=result,
        head=_head(result),
        tiles=[
            (str(verdict), "verdict (good, weak or refused)"),
            (str(result.used), "samples used"),
            (str(len(result.rejected)), "samples left out"),
        ],
        reasons=_notices(result.assessment),
        rotates=any(isinstance(p.shown, Markup) and 'class="poses"' in p.shown for p in result.pictures),
        created=f"{filed.created[:16].replace('T', ' ')} UTC",
        software=", ".join(f"{name} {number}" for name, number in filed.software.items()),
        inputs=filed.inputs,
    )
    write_bytes(page, text.encode())
    if verdict is Verdict.REFUSED:
        reasons = "; ".join(result.assessment.refusals)
        about = ", ".join(f"{role} {serial}" for role, serial in result.serials.items())
        raise CalibrationError(f"{result.kind} calibration, {about}: refused: {reasons} (page: {page})")
    for suffix, content in result.attached.items():
        write_bytes(folder / f"{stem}{suffix}", content)
    figures = {
        "kind": result.kind,
        "file": path,
        "page": page,
        "verdict": str(verdict),
        "reasons": result.assessment.reasons,
        "used": result.used,
        "numbers": result.numbers,
        "rejected": [{"id": r.id, "reason": r.reason} for r in result.rejected],
        "value": result.value,
        "quality": result.quality,
        "simulated": result.simulated,
    }
    return Filed(path, page, plain(figures, str(path)))


def _head(result: CalibrationResult) -> dict[str, str]:
    kind = "TCP" if result.kind == "tcp" else f"{result.kind[:1].upper()}{result.kind[1:]}"
    return {
        "mark": "SIMULATED" if result.simulated else "",
        "bench": ", ".join(f"{role} {serial}" for role, serial in result.serials.items()),
        "what": f"{kind} calibration{result.part and f', {result.part}'}",
        "details": f"samples: {result.source}",
        "remarks": "",
    }


def _notices(assessment: Assessment) -> list[dict[str, str]]:
    """Return the reasons of a verdict as the page's notices."""
    if not assessment.reasons:
        return [{"level": "good", "what": "All measured values are within their limits.", "advice": ""}]
    reasons = [("bad", reason) for reason in assessment.refusals]
    reasons += [("warn", reason) for reason in assessment.doubts]
    return [{"level": level, "what": f"{r[:1].upper()}{r[1:]}.", "advice": ""} for level, r in reasons]


def _as_file(result: CalibrationResult) -> CalibrationFile:
    digest = sha256()
    for path in sorted(result.files):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    inputs = {"source": result.source, "used": result.used, "sha256": digest.hexdigest()}
    software = {name: version(name) for name in ("opencv-contrib-python-headless", "numpy")}
    return CalibrationFile(
        kind=result.kind,
        serials=result.serials,
        value=result.value,
        assessment=result.assessment,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        quality=result.quality,
        rejected=tuple(result.rejected),
        inputs=inputs | ({"simulated": True} if result.simulated else {}),
        software={"visuotactile-slip-rig": VERSION} | software,
    )
