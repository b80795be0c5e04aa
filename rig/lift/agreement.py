"""Compare the estimate of a lift with its true angle, and the markers with the camera's pose."""

from collections.abc import Mapping

import numpy as np

from calibration.time_offset import FEWEST, TimedSignal, time_offset
from rig.config import BenchConfig
from rig.sessions.records import ClockLag, MarkerDistance, TurnsAgainst
from rig.tactile.angles import Angles

LEAST_TURN_DEG = 5.0
"""Least range of both angles over a lift; over less, noise and drift may correlate."""
OPPOSED = -0.9
"""Correlation with the true angle below which an angle turns against it."""
WORST_SIGMA_MS = 15.0
"""Largest standard deviation of a lag that is considered."""
MOST_OFF = 0.10
"""Largest relative difference without a warning: objects have a thickness, markers are not at their
centre."""


def find_turning_against(tips: Mapping[str, Angles], truth: Angles) -> TurnsAgainst | None:
    """Return which fingertips turn against the true angle over a lift; None if none does.

    tips: signed angles since the zero during the lift, by serial; their `zero_ns` is that of `truth`.
    """
    found = {serial: ends for serial, angles in tips.items() if (ends := _opposite_ends(angles, truth))}
    if not found:
        return None
    estimate_deg, truth_deg = max(found.values(), key=lambda ends: abs(ends[0]))
    return TurnsAgainst(tuple(found), len(found) == len(tips) > 1, estimate_deg, truth_deg)


def clock_lag(angles: Angles, truth: Angles) -> ClockLag | None:
    """Return by how much the estimate is late compared with the true angle.

    None if it cannot be determined, because one of them turns too little or otherwise.
    angles: the fused estimate during the lift.
    """
    known = angles.known
    times, first = np.unique(known.time_ns, return_index=True)  # two fingertips may have the same times
    estimate = TimedSignal(times, known.angle_deg[first])
    true = TimedSignal(truth.time_ns, truth.angle_deg)
    if any(len(s.time_ns) < FEWEST or np.ptp(s.values) < LEAST_TURN_DEG for s in (estimate, true)):
        return None
    found = time_offset(true, estimate, worst_ms=WORST_SIGMA_MS)
    if found.offset_s is None or found.sigma_s is None or not found.gain or found.gain < 0.0:
        return None
    return ClockLag(-found.offset_s, found.sigma_s)


def _opposite_ends(angles: Angles, truth: Angles) -> tuple[float, float] | None:
    """Return the last angle and the last true angle if both turn far enough in opposite directions."""
    ours, true = angles.angle_deg, truth.at(angles.time_s)
    both = np.isfinite(ours) & np.isfinite(true)
    ours, true = ours[both], true[both]
    if len(ours) < FEWEST or min(np.ptp(ours), np.ptp(true)) < LEAST_TURN_DEG:
        return None
    return (float(ours[-1]), float(true[-1])) if np.corrcoef(ours, true)[0, 1] <= OPPOSED else None


def distance_warning(bench: BenchConfig, sides: float | None) -> MarkerDistance | None:
    """Compare the distance of the markers, in marker sides, with the pose of the camera and the table's mark.

    Return None within 10 %, or if it is unknown.
    """
    if sides is None:
        return None
    seen_m, placed_m = sides * bench.require("camera").marker_side_m, bench.object_distance_m()
    return MarkerDistance(seen_m, placed_m) if abs(seen_m - placed_m) > MOST_OFF * placed_m else None
