"""The head of every report of a session."""

from rig.sessions.manifest import BenchManifest, TrialManifest


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
