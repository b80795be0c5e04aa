"""Summary of interrupted lifts, as commands print it."""

from typing import Any

from drivers.errors import counted
from rig.experiments.interrupted import InterruptedLift
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC


def interrupted_text(lift: InterruptedLift) -> str:
    """Return one line: which lift, how far it came, and the angles at its end."""
    angles = [f"{what} {_text(lift.last_deg(topic))}" for what, topic in _ANGLES.items()]
    damaged = f"; damaged: {'; '.join(lift.gaps)}" if lift.gaps else ""
    return (
        f"unfinished, not counted: {lift.recording}: {lift.name}, {lift.seconds:.1f} s, "
        f"{counted(lift.frames, 'frame')}, phases {', '.join(lift.phases_ns)}; "
        f"at its end {', '.join(angles)}{damaged}"
    )


def interrupted_json(lift: InterruptedLift) -> dict[str, Any]:
    """Return the same as values for JSON output."""
    return {
        "recording": lift.recording,
        "lift": lift.name,
        "seconds": round(lift.seconds, 3),
        "frames": lift.frames,
        "phases": list(lift.phases_ns),
        **{f"{what}_deg": lift.last_deg(topic) for what, topic in _ANGLES.items()},
        "gaps": list(lift.gaps),
    }


def _text(angle_deg: float | None) -> str:
    return "none" if angle_deg is None else f"{angle_deg:+.1f} deg"


_ANGLES = {"estimate": FUSED_TOPIC, "markers": TRUTH_TOPIC}
