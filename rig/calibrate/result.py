"""The result of a calibration command: a file, a page, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calibration.store import CalibrationFile, load, plain, save, write_bytes
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from rig.calibrate.figures import Picture
from rig.pages.page import render
from rig.report.parts import Notice
from rig.version import VERSION


@dataclass(frozen=True, slots=True)
class CalibrationResult(CalibrationFile):
    """A calibration with what its page shows, before it is filed.

    source: folder of the samples. numbers: the figures at the top of the page, as text. used: number of
    samples. files: the samples, for the hash. thumbnails: PNG bytes of rejected samples by id. part: of the
    kind, if it has several files. attached: content of further files of the same name, by suffix; not written
    if refused.
    """

    source: str = ""
    numbers: Mapping[str, str] = field(default_factory=dict)
    used: int = 0
    files: Sequence[Path] = ()
    pictures: Sequence[Picture] = ()
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)
    simulated: bool = False
    part: str = ""
    attached: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def about(self) -> str:
        return ", ".join(f"{role} {serial}" for role, serial in self.serials.items())


def file_result(result: CalibrationResult, folder: Path) -> dict[str, Any]:
    """Write file and page into a folder; return the figures for `--json`, with the paths "file" and "page".

    Both state the time, the hash of the samples and the versions of the software. Raises `CalibrationError`
    for a refused calibration, after writing both; it does not replace one that a bench can use.
    """
    part = [result.part] if result.part else []
    stem = "-".join([result.kind, *part, *result.serials.values()])
    verdict = result.assessment.verdict
    if verdict is Verdict.REFUSED:
        with suppress(CalibrationError):  # there is none, or it was refused as well
            load(folder / f"{stem}.yaml", result.kind)
            stem += "-refused"
    path, page = folder / f"{stem}.yaml", folder / f"{stem}.html"
    digest = sha256()
    for sample in sorted(result.files):
        digest.update(sample.name.encode())
        digest.update(sample.read_bytes())
    inputs = {"source": result.source, "used": result.used, "sha256": digest.hexdigest()}
    software = {name: version(name) for name in ("opencv-contrib-python-headless", "numpy")}
    result = replace(
        result,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        inputs=inputs | ({"simulated": True} if result.simulated else {}),
        software={"visuotactile-slip-rig": VERSION} | software,
    )
    save(result, path)
    write_bytes(page, _page(result).encode())
    if verdict is Verdict.REFUSED:
        reasons = "; ".join(result.assessment.refusals)
        raise CalibrationError(
            f"{result.kind} calibration, {result.about}: refused: {reasons} (page: {page})"
        )
    for suffix, content in result.attached.items():
        write_bytes(folder / f"{stem}{suffix}", content)
    figures = {
        "kind": result.kind,
        "file": path,
        "page": page,
        "verdict": verdict,
        "reasons": result.assessment.reasons,
        "used": result.used,
        "numbers": result.numbers,
        "rejected": [{"id": r.id, "reason": r.reason} for r in result.rejected],
        "value": result.value,
        "quality": result.quality,
        "simulated": result.simulated,
    }
    return plain(figures, str(path))


def _page(result: CalibrationResult) -> str:
    kind = "TCP" if result.kind == "tcp" else f"{result.kind[:1].upper()}{result.kind[1:]}"
    found = (("bad", result.assessment.refusals), ("warn", result.assessment.doubts))
    notices = [
        Notice(level, f"{reason[:1].upper()}{reason[1:]}.", "") for level, of in found for reason in of
    ]
    return render(
        "rig.calibrate",
        "page.html",
        result=result,
        head={
            "mark": "SIMULATED" if result.simulated else "",
            "bench": result.about,
            "what": f"{kind} calibration{result.part and f', {result.part}'}",
            "details": f"samples: {result.source}",
            "remarks": "",
        },
        tiles=[
            (str(result.assessment.verdict), "verdict (good, weak or refused)"),
            (str(result.used), "samples used"),
            (str(len(result.rejected)), "samples left out"),
        ],
        reasons=notices or [Notice("good", "All measured values are within their limits.", "")],
        rotates=any('class="poses"' in picture.svg for picture in result.pictures),
        created=f"{result.created[:16].replace('T', ' ')} UTC",
        software=", ".join(f"{name} {number}" for name, number in result.software.items()),
    )
