"""How fast something turns, from a stream of orientations: what a robot and a camera on it both see.

Rates need no hand-eye transform and no common frame, so they tell the offset between two clocks first
(Furrer et al. 2017 correlate them).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

from calibration.time_offset import TimedSignal, make_stream
from drivers.errors import CalibrationError

_SPAN_NS = 100_000_000
"""Turns are measured over so long: less is noise, more smooths the motion away."""
_AROUND = 15
"""Samples around one, in which a spike of half a span at either end of a flip is the minority."""


def turning_rate(
    time_ns: NDArray[np.int64], quaternions_xyzw: NDArray[np.floating], name: str
) -> TimedSignal:
    """The rate in rad/s about any axis over 0.1 s around each time, orientations between samples by slerp.

    time_ns: (N,) int64; quaternions_xyzw: (N, 4). Raises `CalibrationError` for orientations that are none,
    and as `make_stream` does.
    """
    times, values = np.asarray(time_ns), np.asarray(quaternions_xyzw, np.float64)
    if values.shape != (len(times), 4):
        raise CalibrationError(f"sync: {name}: (N, 4) quaternions for N times are needed, got {values.shape}")
    length = np.linalg.norm(values, axis=1)
    usable = np.flatnonzero(np.abs(length - 1.0) < 0.01)  # false for NaN
    usable = usable[np.argsort(times[usable], kind="stable")]
    times, values = times[usable], values[usable]
    fresh = np.append(True, np.diff(times) > 0) if len(times) else np.zeros(0, bool)
    times, values = times[fresh], values[fresh]
    middle = times[_inside(times)] if len(times) else times
    if not len(middle):
        raise CalibrationError(
            f"sync: {name}: no orientations over 0.1 s without a gap; is the stream too slow?"
        )
    turn = Slerp(times - times[0], Rotation.from_quat(values))
    before, after = (turn(middle - times[0] + step) for step in (-_SPAN_NS // 2, _SPAN_NS // 2))
    rates = (before.inv() * after).magnitude() / (_SPAN_NS / 1e9)
    return make_stream(middle, np.where(_spikes(rates), np.nan, rates), name)


def _inside(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether there are samples up to half a span on either side, and none is far from the next."""
    half = _SPAN_NS // 2
    first, last = np.searchsorted(times, times - half, "right") - 1, np.searchsorted(times, times + half)
    whole = (first >= 0) & (last < len(times))
    wide = np.zeros(len(times), bool)
    wide[whole] = times[last[whole]] - times[first[whole]] < 3 * _SPAN_NS
    return wide


def _spikes(rates: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(N,) whether a rate stands out from those around it, as where a detector takes a target for its mirror.

    Hampel's filter: more than five robust deviations from the running median.
    """
    middle = median_filter(rates, _AROUND, mode="nearest")
    away = np.abs(rates - middle)
    usual = median_filter(away, 8 * _AROUND + 1, mode="nearest")
    return away > 5.0 * 1.4826 * usual + 0.05
