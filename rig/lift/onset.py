"""Detect when a slip begins, from an angle over time (contract, metrics)."""

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.angles import LONGEST_GAP_NS, Angles

ONSET_DEG = 0.5
"""Rotation from rest that defines the slip onset (contract, metrics)."""
GROWTH_NS = 100_000_000
"""Time for which the angle must keep growing (contract, metrics)."""
LEAST_GROWTH_DEG = 0.1
MOST_FALL_DEG = 0.1
"""Least growth over GROWTH_NS, and largest decrease within it, so that the noise of a frame is not growth."""
AVERAGED_NS = 50_000_000
"""Window over which estimated angles are averaged before growth is detected in them."""


ALARM_DEG = 0.4
ALARM_RATE_DEG_S = 2.0
"""Thresholds of the live slip event. It is raised a little before the contract's 0.5 degrees and without
waiting for 100 ms of growth, because a controller cannot wait. So it can be false; `rig benchmark` measures
how often."""


def leaves_rest(angle_deg: float, rate_deg_s: float) -> bool:
    """Whether an object has left its angle at rest, 0, and is still moving away faster than the noise.

    This raises the slip event of a lift, with the fused angle since the zero.
    """
    away = abs(angle_deg) >= ALARM_DEG and angle_deg * rate_deg_s > 0.0
    return away and abs(rate_deg_s) >= ALARM_RATE_DEG_S


def estimated_onset_ns(angles: Angles) -> int | None:
    """Return when a slip begins according to all estimated angles since the zero; None without one.

    The camera measures the true angle every 33 ms, and averages during exposure. The fingertips' estimates
    are more frequent and noisier, so each is first averaged over `AVERAGED_NS` around it. Of two estimates at
    the same time (fingertips that capture simultaneously) the later one is used, because it includes both.
    """
    known = angles.known
    if not len(known):
        return None
    time_ns = known.time_ns
    later = np.append(np.diff(time_ns) > 0, True)
    time_ns, angle = time_ns[later], known.angle_deg[later]
    first = np.searchsorted(time_ns, time_ns - AVERAGED_NS // 2)
    last = np.searchsorted(time_ns, time_ns + AVERAGED_NS // 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(angle)])
    return slip_onset_ns(time_ns, (sums[last] - sums[first]) / (last - first))


def slip_onset_ns(time_ns: NDArray[np.int64], angle_deg: NDArray[np.float64]) -> int | None:
    """Return when the angle has left 0 by 0.5 degrees and keeps growing for 100 ms, or None.

    time_ns: (N,) int64, increasing. angle_deg: (N,) float64, 0 at rest. The time is interpolated between the
    frames on either side of 0.5 degrees. To exclude noise, over the 100 ms a fitted line must gain 0.1
    degrees (five sigma of the two-marker angle), and the angle must never fall 0.1 degrees below its previous
    maximum. Frames more than 50 ms apart, or the end of the series, leave growth unproven. Raises
    `InputError` for unequal lengths, times that do not increase, or NaN and infinite values.
    """
    _check(time_ns, angle_deg, 0.0)
    away = np.asarray(angle_deg, np.float64)
    for i in np.flatnonzero(np.abs(away) >= ONSET_DEG):
        slope = away if away[i] > 0 else -away
        start_ns, start_deg = _departure(time_ns, slope, int(i))
        if _keeps_growing(time_ns[i:], slope[i:], start_ns, start_deg):
            return start_ns
    return None


def departure_ns(
    time_ns: NDArray[np.int64], angle_deg: NDArray[np.float64], rest_deg: float = 0.0
) -> int | None:
    """Return when the angle first left rest by 0.5 degrees, whether or not it keeps growing; None if never.

    For a rotation that a reaction ends. rest_deg: the angle at rest; other arguments and errors as for
    `slip_onset_ns`.
    """
    _check(time_ns, angle_deg, rest_deg)
    away = np.abs(np.asarray(angle_deg, np.float64) - rest_deg)
    left = np.flatnonzero(away >= ONSET_DEG)
    return _departure(time_ns, away, int(left[0]))[0] if len(left) else None


def _departure(time_ns: NDArray[np.int64], away_deg: NDArray[np.float64], i: int) -> tuple[int, float]:
    """Return time and angle at which the threshold was passed before sample i, or those of the sample."""
    at_ns, at_deg = int(time_ns[i]), float(away_deg[i])
    if i == 0 or away_deg[i - 1] >= ONSET_DEG or at_ns - int(time_ns[i - 1]) > LONGEST_GAP_NS:
        return at_ns, at_deg
    share = (ONSET_DEG - away_deg[i - 1]) / (at_deg - away_deg[i - 1])
    before_ns = int(time_ns[i - 1])
    return before_ns + round(share * (at_ns - before_ns)), ONSET_DEG


def _keeps_growing(
    time_ns: NDArray[np.int64], away_deg: NDArray[np.float64], start_ns: int, start_deg: float
) -> bool:
    """Whether the samples from the start to the first one after 100 ms grow without a gap."""
    end = int(np.searchsorted(time_ns, start_ns + GROWTH_NS)) + 1
    if end > len(time_ns):
        return False
    times = np.append(start_ns, time_ns[:end]) - start_ns
    values = np.append(start_deg, away_deg[:end])
    if np.diff(times).max() > LONGEST_GAP_NS:
        return False
    if (np.maximum.accumulate(values) - values).max() > MOST_FALL_DEG:
        return False
    centred = times - times.mean()
    gain = float(centred @ values / (centred @ centred)) * GROWTH_NS
    return gain >= LEAST_GROWTH_DEG


def _check(time_ns: NDArray[np.int64], angle_deg: NDArray[np.float64], rest_deg: float) -> None:
    if time_ns.ndim != 1 or time_ns.shape != angle_deg.shape:
        raise InputError(
            f"slip onset: as many times as angles needed, got {time_ns.shape}, {angle_deg.shape}"
        )
    if not np.isfinite(angle_deg).all() or not np.isfinite(rest_deg):
        raise InputError("slip onset: an angle is NaN or infinite; leave refused frames out")
    if (np.diff(time_ns) <= 0).any():
        raise InputError("slip onset: the times do not increase; sort the frames and drop repeated ones")
