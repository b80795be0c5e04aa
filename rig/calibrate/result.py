"""The result of a calibration command: a file, a page, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from calibration.store import CalibrationFile, load, plain, save, write_bytes
from calibration.verdict import Assessment, Rejected, Verdict
from drivers.errors import CalibrationError
from rig.calibrate.charts import Picture
from rig.calibrate.samples import has_simulated_samples
from rig.pages.page import render
from rig.report.parts import Notice
from rig.version import version_text

MM, DEGREES = (".2f", "mm", 1e3), (".3f", "degrees", 180.0 / np.pi)
"""Format, unit and factor of a length in m and of an angle in rad, for a `Figure`."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured value for the file, the page and the terminal.

    name: its key in the file; "" if the file has it in another form. value: a number, an array, text, or
    numbers by name; None if it is unknown, then it is left out. label: its name on page and terminal; "" if
    only the file has it. digits: format of each number there. unit, scale: the unit there and its factor.
    sigma: one sigma, in the unit of the value; in the file as `NAME_sigma`. top: whether it is among the
    calibrated values of the file, not under `quality`.
    """

    name: str
    value: Any
    label: str = ""
    digits: str = ""
    unit: str = ""
    scale: float = 1.0
    sigma: Any = None
    top: bool = False

    def __str__(self) -> str:
        if self.value is None or isinstance(self.value, str):
            return self.value or ""
        values = self.value if isinstance(self.value, Mapping) else {"": self.value}
        numbers = [(f"{name} ".lstrip(), v) for name, each in values.items() for v in np.ravel(each)]
        sigmas = [None] * len(numbers) if self.sigma is None else np.ravel(self.sigma)
        texts = [
            f"{name}{self.scale * v:{self.digits}}"
            + ("" if s is None else f" ± {self.scale * s:{self.digits}}")
            for (name, v), s in zip(numbers, sigmas, strict=True)
        ]
        return f"{', '.join(texts)} {self.unit}".strip() if texts else ""


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration with what its page shows, before it is stored.

    kind, serials, rejected: as in `CalibrationFile`. layout: calibrated values in the layout of their field;
    the others are figures. source: folder of the samples, and of their
    mark SIMULATED, which the result gets. used: number of samples. files: the samples, for
    the hash. thumbnails: PNG bytes of rejected samples by id. part: of the kind, if it has several files.
    attached: content of further files of the same name, by suffix; not written if refused.
    """

    kind: str
    serials: Mapping[str, str]
    layout: Mapping[str, Any]
    assessment: Assessment
    figures: Sequence[Figure] = ()
    rejected: Sequence[Rejected] = ()
    source: str = ""
    used: int = 0
    files: Sequence[Path] = ()
    pictures: Sequence[Picture] = ()
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)
    simulated: bool = False
    part: str = ""
    attached: Mapping[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if has_simulated_samples(Path(self.source)):
            object.__setattr__(self, "simulated", True)

    @property
    def about(self) -> str:
        return ", ".join(f"{role} {serial}" for role, serial in self.serials.items())

    @property
    def value(self) -> dict[str, Any]:
        """The calibrated values of the file."""
        return {**self.layout, **{each.name: each.value for each in self._known_figures() if each.top}}

    @property
    def quality(self) -> dict[str, Any]:
        """The other values of the file."""
        values = {each.name: each.value for each in self._known_figures() if not each.top}
        return values | {f"{f.name}_sigma": f.sigma for f in self._known_figures() if f.sigma is not None}

    @property
    def numbers(self) -> dict[str, str]:
        """The values of page and terminal as text, by label."""
        return {each.label: str(each) for each in self.figures if each.label and str(each)}

    def _known_figures(self) -> list[Figure]:
        return [each for each in self.figures if each.name and each.value is not None]


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
    file = CalibrationFile(
        result.kind,
        result.serials,
        result.value,
        result.assessment,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        quality=result.quality,
        rejected=result.rejected,
        inputs=inputs | ({"simulated": True} if result.simulated else {}),
        software={"visuotactile-slip-rig": version_text()} | software,
    )
    save(file, path)
    write_bytes(page, _page(result, file).encode())
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


def _page(result: CalibrationResult, file: CalibrationFile) -> str:
    kind = "TCP" if result.kind == "tcp" else f"{result.kind[:1].upper()}{result.kind[1:]}"
    found = (("bad", result.assessment.refusals), ("warn", result.assessment.doubts))
    notices = [
        Notice(level, f"{reason[:1].upper()}{reason[1:]}.", "") for level, of in found for reason in of
    ]
    return render(
        "rig.calibrate",
        "page.html",
        result=result,
        digest=file.inputs["sha256"],
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
        created=f"{file.created[:16].replace('T', ' ')} UTC",
        software=", ".join(f"{name} {number}" for name, number in file.software.items()),
    )
