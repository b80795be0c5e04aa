"""Texts that are the same on every page: the head of a session's report, and formatted numbers."""

import math
from datetime import datetime

from rig.results.metrics import Mare
from rig.sessions.manifest import BenchManifest, TrialManifest


def mare_tile(value: Mare | None, what: str) -> tuple[str, str]:
    """Return the tile of a MARE: the figure, and below it a description with interval and refused lifts."""
    return mare_short(value), f"{what} {value.beside if value else ''}".rstrip()


def mare_short(value: Mare | None) -> str:
    """Return MARE and standard deviation, deg."""
    return "no answer" if value is None else f"{value.mean_deg:.2f} ± {value.std_deg:.2f}°"


def made_text(when: datetime) -> str:
    """Return the creation time of a page. when: in UTC."""
    return when.strftime("%Y-%m-%d %H:%M UTC")


def angle_text(angle_deg: float | None) -> str:
    """Return an angle with its sign."""
    if angle_deg is None or not math.isfinite(angle_deg):
        return "refused"
    return f"{round(angle_deg, 1) + 0.0:+.1f}°"


def header(manifest: BenchManifest, what: str) -> dict[str, str]:
    """Return the texts of the head: SIMULATED or not, bench, date, settings, and the session's metadata."""
    trial = manifest if isinstance(manifest, TrialManifest) else None
    parts = [
        manifest.started.replace("T", " ")[:16],
        f"estimator {trial.estimator}, window {trial.window}" if trial else "",
        f"seed {manifest.seed}" if manifest.simulated else "",
        f"rig {manifest.tool_version}",
    ]
    return {
        "mark": "SIMULATED" if manifest.simulated else "",
        "bench": f"bench '{manifest.bench}'",
        "what": f"{manifest.remarks.name}: {what}" if manifest.remarks.name else what,
        "remarks": " · ".join(manifest.remarks.lines()),
        "details": ", ".join(part for part in parts if part),
    }
