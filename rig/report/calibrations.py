"""Which calibrations a session used, and how old they are."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from calibration.store import age_days, age_text
from rig.report.parts import Notice, Table, joined

OLD_DAYS = 30.0
NEEDED = ("camera", "hand-eye")
"""What the marker angle rests on."""


def calibration_table(manifest: Mapping[str, Any], now: datetime) -> Table | None:
    """A row per calibration that the manifest names; None where it names none."""
    rows = [
        [
            name,
            str(about.get("file") or about.get("path") or "-"),
            str(about.get("verdict") or "-"),
            _age(about, now),
        ]
        for name, about in _named(manifest).items()
    ]
    return Table(("calibration", "file", "verdict", "age"), rows, text=(0, 1, 2, 3)) if rows else None


def calibration_notices(manifest: Mapping[str, Any], now: datetime) -> list[Notice]:
    """What to say about them: missing on a real bench, old, or weak."""
    named = _named(manifest)
    notices = []
    missing = [kind for kind in NEEDED if not any(name.startswith(kind) for name in named)]
    if missing and not manifest.get("simulated"):
        advice = (
            "The numbers typed into the bench file are used instead, and the marker angle is no better than "
            f"they are: rig calibrate {missing[0]}."
        )
        notices.append(Notice("warn", f"No calibration of {joined(missing)} is in use.", advice))
    old = [
        f"{name} ({_age(about, now)})"
        for name, about in named.items()
        if (_days(about, now) or 0.0) > OLD_DAYS
    ]
    if old:
        advice = "Look whether it still holds: rig calibrate compare, or calibrate again."
        notices.append(Notice("warn", f"Old calibrations: {joined(old)}.", advice))
    weak = [name for name, about in named.items() if about.get("verdict") == "weak"]
    if weak:
        advice = "Their pages say what was missing; more or better samples make them good."
        notices.append(Notice("warn", f"Weak calibrations: {joined(weak)}.", advice))
    return notices


def _named(manifest: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    found = manifest.get("calibration") or {}
    return {
        name: about if isinstance(about, Mapping) else {"file": about}
        for name, about in found.items()
        if about
    }


def _days(about: Mapping[str, Any], now: datetime) -> float | None:
    try:
        return age_days(str(about.get("created")), now)
    except ValueError:
        return None


def _age(about: Mapping[str, Any], now: datetime) -> str:
    days = _days(about, now)
    return "unknown" if days is None else age_text(days)
