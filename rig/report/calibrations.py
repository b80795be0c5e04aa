"""The calibrations that a session used, and their age."""

from datetime import datetime

from calibration.store import age_days, age_text
from calibration.verdict import Verdict
from rig.config.in_use import FileInUse
from rig.report.parts import Notice, Table, joined
from rig.sessions.manifest import BenchManifest

OLD_DAYS = 30.0
NEEDED = ("camera", "hand-eye")
"""Calibrations that the marker angle depends on."""


def calibration_table(manifest: BenchManifest, now: datetime) -> Table | None:
    """Return a row per calibration in the manifest; None if there is none."""
    rows = [
        [name, about.file, about.verdict, _age(about, now)] for name, about in manifest.calibration.items()
    ]
    return Table(("calibration", "file", "verdict", "age"), rows, text=(0, 1, 2, 3)) if rows else None


def calibration_notices(manifest: BenchManifest, now: datetime) -> list[Notice]:
    """Return notices about calibrations that are old, weak, or missing on a real bench."""
    named = manifest.calibration
    notices = []
    missing = [kind for kind in NEEDED if not any(name.startswith(kind) for name in named)]
    if missing and not manifest.simulated:
        advice = (
            "The values in the bench file are used instead, and limit the accuracy of the marker angle. Run "
            f"rig calibrate {missing[0]}."
        )
        notices.append(Notice("warn", f"No calibration of {joined(missing)} is in use.", advice))
    old = [
        f"{name} ({_age(about, now)})"
        for name, about in named.items()
        if (_days(about, now) or 0.0) > OLD_DAYS
    ]
    if old:
        advice = "Check that they are still valid with rig calibrate compare, or calibrate again."
        notices.append(Notice("warn", f"Old calibrations: {joined(old)}.", advice))
    weak = [name for name, about in named.items() if about.verdict == Verdict.WEAK]
    if weak:
        advice = "Their pages state the reasons; more or better samples improve them."
        notices.append(Notice("warn", f"Weak calibrations: {joined(weak)}.", advice))
    return notices


def _days(about: FileInUse, now: datetime) -> float | None:
    try:
        return age_days(about.created, now)
    except ValueError:
        return None


def _age(about: FileInUse, now: datetime) -> str:
    days = _days(about, now)
    return "unknown" if days is None else age_text(days)
