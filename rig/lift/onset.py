"""When a slip begins, from an angle over time (contract, metrics)."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError

ONSET_DEG = 0.5
GROWTH_NS = 100_000_000
LONGEST_GAP_NS = 50_000_000
"""Over a longer gap there is no truth (contract, metrics)."""
LEAST_GROWTH_DEG = 0.1
MOST_FALL_DEG = 0.1
AVERAGED_NS = 50_000_000
"""Over so long estimated angles are averaged to look for growth in them."""


ALARM_DEG = 0.4
ALARM_RATE_DEG_S = 2.0
"""The event is raised a little before the contract's 0.5 degrees and on less evidence than 100 ms of
growth, as a controller cannot wait for them; so it can be false, and `rig benchmark` says how often."""


@dataclass(slots=True)
class OnsetAlarm:
    """Raises the slip event while a lift runs, once. Angles are from the trial's zero."""

    raised_ns: int | None = None

    def update(self, time_ns: int, angle_deg: float | None, rate_deg_s: float | None) -> bool:
        """Take a fused answer; True at the moment the event is raised.

        The angle has left rest, is still moving away, and faster than the rest's own noise.
        """
        if self.raised_ns is not None or angle_deg is None or rate_deg_s is None:
            return False
        away = abs(angle_deg) >= ALARM_DEG and angle_deg * rate_deg_s > 0.0
        if not (away and abs(rate_deg_s) >= ALARM_RATE_DEG_S):
            return False
        self.raised_ns = time_ns
        return True


def estimated_onset_ns(answers: Iterable[tuple[int, float | None]]) -> int | None:
    """Return when a slip begins by estimated angles, looking back; None without one.

    answers: time in ns and angle in degrees since the zero, None where refused. The camera sees the
    true angle once in 33 ms and averages while it is exposed; the fingertips' answers are more and
    noisier, so each is averaged over `AVERAGED_NS` around it first. Of two answers at one time
    (fingertips that capture together) the later one counts, as it knows of both.
    """
    told = {time_ns: angle for time_ns, angle in answers if angle is not None}
    if not told:
        return None
    time_ns, angle = (np.array(column) for column in zip(*sorted(told.items()), strict=True))
    first = np.searchsorted(time_ns, time_ns - AVERAGED_NS // 2)
    last = np.searchsorted(time_ns, time_ns + AVERAGED_NS // 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(angle)])
    return slip_onset_ns(time_ns, (sums[last] - sums[first]) / (last - first))


def slip_onset_ns(
    time_ns: NDArray[np.int64], angle_deg: NDArray[np.float64], rest_deg: float = 0.0
) -> int | None:
    """Return when the angle has left rest by 0.5 degrees and keeps growing for 100 ms, or None.

    time_ns: (N,) int64, increasing. angle_deg: (N,) float64. rest_deg: the rest value, 0 for an
    angle since the trial's zero. The time is interpolated between the frames on either side of
    0.5 degrees. A frame's noise is no growth: over the 100 ms the best line must gain 0.1 degrees
    (five sigma of the two-marker angle) and the angle never fall 0.1 degrees below what it had
    reached. Frames more than 50 ms apart, or the series' end, leave growth unproven.
    Raises `InputError` for unequal lengths, times that do not increase, values not finite.
    """
    _check(time_ns, angle_deg, rest_deg)
    away = np.asarray(angle_deg, np.float64) - rest_deg
    for i in np.flatnonzero(np.abs(away) >= ONSET_DEG):
        slope = away if away[i] > 0 else -away
        start_ns, start_deg = _departure(time_ns, slope, int(i))
        if _keeps_growing(time_ns[i:], slope[i:], start_ns, start_deg):
            return start_ns
    return None


def departure_ns(
    time_ns: NDArray[np.int64], angle_deg: NDArray[np.float64], rest_deg: float = 0.0
) -> int | None:
    """Return when the angle has first left rest by 0.5 degrees, whether it grows on or not; None if never.

    For a turn that a reaction ends. Arguments and errors as of `slip_onset_ns`.
    """
    _check(time_ns, angle_deg, rest_deg)
    away = np.abs(np.asarray(angle_deg, np.float64) - rest_deg)
    left = np.flatnonzero(away >= ONSET_DEG)
    return _departure(time_ns, away, int(left[0]))[0] if len(left) else None


def _departure(time_ns: NDArray[np.int64], away_deg: NDArray[np.float64], i: int) -> tuple[int, float]:
    """Time and angle at which the threshold was passed before sample i, or the sample itself."""
    at_ns, at_deg = int(time_ns[i]), float(away_deg[i])
    if i == 0 or away_deg[i - 1] >= ONSET_DEG or at_ns - int(time_ns[i - 1]) > LONGEST_GAP_NS:
        return at_ns, at_deg
    share = (ONSET_DEG - away_deg[i - 1]) / (at_deg - away_deg[i - 1])
    before_ns = int(time_ns[i - 1])
    return before_ns + round(share * (at_ns - before_ns)), ONSET_DEG


def _keeps_growing(
    time_ns: NDArray[np.int64], away_deg: NDArray[np.float64], start_ns: int, start_deg: float
) -> bool:
    """Whether the samples from the start on, to the first past 100 ms, grow without a gap."""
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
        raise InputError("slip onset: an angle is not a finite number; leave refused frames out")
    if (np.diff(time_ns) <= 0).any():
        raise InputError("slip onset: the times do not increase; sort the frames and drop repeated ones")
