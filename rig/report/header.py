"""What stands above every report of a session."""

from typing import Any


def header(manifest: dict[str, Any], what: str) -> dict[str, str]:
    """Say whether it is simulated, which bench, when, and with what."""
    simulated = bool(manifest.get("simulated"))
    known = "estimator" in manifest
    parts = [
        str(manifest.get("started", "")).replace("T", " ")[:16],
        f"estimator {manifest['estimator']}, window {manifest.get('window')}" if known else "",
        f"seed {manifest['seed']}" if simulated and "seed" in manifest else "",
        f"rig {manifest.get('tool_version', '?')}",
    ]
    return {
        "mark": "SIMULATED" if simulated else "",
        "bench": f"bench '{manifest.get('bench', 'unknown')}'",
        "what": what,
        "details": ", ".join(part for part in parts if part),
    }
