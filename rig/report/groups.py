"""Errors by groups of lifts: by object, and by the grasped surface."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from drivers.errors import InputError, counted
from protocols.grasps import GraspFile, find_grasp_file
from rig.report.curves import signed_errors
from rig.report.distributions import boxes
from rig.report.parts import Chart
from rig.results.metrics import Floats
from rig.sessions.records import Lift

PAPER_MARE_DEG = 1.85
"""Castano-Amoros and Gil 2023, Table III: MARE of 45 lifts of its nine objects."""
SURFACES = ("edge", "flat", "cylinder", "ball")


def errors_by(lifts: Sequence[Lift], group: Callable[[Lift], str]) -> dict[str, Floats]:
    """Return the absolute errors in phase B, (N,) deg, by the group of their lift."""
    found: dict[str, list[Floats]] = {}
    for lift in lifts:
        parts = found.setdefault(group(lift), [])
        if lift.curves is not None:
            errors = np.abs(signed_errors(lift.curves))[lift.curves.within("B")]
            parts.append(errors[np.isfinite(errors)])
    return {name: np.concatenate([np.zeros(0), *parts]) for name, parts in found.items()}


def object_chart(lifts: Sequence[Lift]) -> Chart:
    """Draw the paper's box plot: a box per object over all frames of phase B."""
    return boxes(
        errors_by(lifts, lambda lift: lift.label),
        "Rotational error per object",
        "All frames of phase B, as in the paper's figure: median, quartiles, whiskers from least to most. "
        f"Dashed: {PAPER_MARE_DEG}°, the paper's mean over all objects on its real bench; it prints no "
        "number per object.",
        mark=PAPER_MARE_DEG,
    )


def surface_chart(lifts: Sequence[Lift], own: Sequence[GraspFile] = ()) -> Chart | None:
    """Draw a box per kind of surface in the object files; None if there are fewer than two kinds.

    own: a lab's objects, as stored in the session.
    """
    named = [lift for lift in lifts if surface(lift, own)]
    groups = errors_by(named, lambda lift: surface(lift, own))
    counts = Counter(surface(lift, own) for lift in named)
    groups = {f"{s} ({counted(counts[s], 'lift')})": groups[s] for s in SURFACES if s in groups}
    if len(groups) < 2:
        return None
    caption = (
        "Phase B, by what the fingers hold (as the object files name it): the paper's edge and cylinder."
    )
    return boxes(groups, "Error by grasped surface", caption)


def surface(lift: Lift, own: Sequence[GraspFile] = ()) -> str:
    """Return the surface at the lift's grasp position in the object file; "" if it is not given."""
    try:
        grasps = find_grasp_file(lift.object, own)
    except InputError:
        return ""
    place = next((p for p in grasps.position if p.name == lift.position), None)
    return (place.surface or "") if place else ""
