"""Detect estimates that turn against the true angle over a lift, or follow it at another time.

Both are faults of the bench, not of the estimator: exchanged fingertips, or a clock that is off. They are
recognised from the shape of both angles over the lift, so the object has to turn.
"""

from collections.abc import Mapping

import numpy as np

from calibration.time_offset import FEWEST, TimedSignal, time_offset
from rig.sessions.records import ClockLag, TurnsAgainst
from rig.tactile.angles import Angles

LEAST_TURN_DEG = 5.0
"""Least range of both angles over a lift; over less, noise and drift may correlate."""
OPPOSED = -0.9
"""Correlation with the true angle below which an angle turns against it."""
MOST_LAG_S = 0.05
"""Largest lag without a warning: the camera's frames may be as far apart (contract), and an object that turns
by 40 degrees a second is 2 degrees further by then. 27 SIMULATED lifts, easy and hard, have at most 0.012."""
WORST_SIGMA_MS, SURE = 15.0, 3.0
"""Largest standard deviation of a lag that is considered, and by how many of them it must exceed 0."""


def turns_against(tips: Mapping[str, Angles], truth: Angles) -> TurnsAgainst | None:
    """Return which fingertips turn against the true angle over a lift; None if none does.

    tips: signed angles since the zero during the lift, by serial; their `zero_ns` is that of `truth`.
    """
    found = {serial: ends for serial, angles in tips.items() if (ends := _opposed(angles, truth))}
    if not found:
        return None
    estimate_deg, truth_deg = max(found.values(), key=lambda ends: abs(ends[0]))
    return TurnsAgainst(tuple(found), len(found) == len(tips) > 1, estimate_deg, truth_deg)


def clock_lag(angles: Angles, truth: Angles) -> ClockLag | None:
    """Return by how much the estimate is late compared with the true angle, if it is a reason for a warning.

    None if the lag is small, or cannot be determined because one of them turns too little or otherwise.
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
    lag_s = -found.offset_s
    return ClockLag(lag_s, found.sigma_s) if abs(lag_s) > max(MOST_LAG_S, SURE * found.sigma_s) else None


def _opposed(angles: Angles, truth: Angles) -> tuple[float, float] | None:
    """Return the last angle and the last true angle if both turn far enough in opposite directions."""
    ours, true = angles.angle_deg, truth.at(angles.time_s)
    both = np.isfinite(ours) & np.isfinite(true)
    ours, true = ours[both], true[both]
    if len(ours) < FEWEST or min(np.ptp(ours), np.ptp(true)) < LEAST_TURN_DEG:
        return None
    return (float(ours[-1]), float(true[-1])) if np.corrcoef(ours, true)[0, 1] <= OPPOSED else None
