"""How fast something turns, from a stream of orientations: what a robot and a camera on it both see.

Rates need no hand-eye transform and no common frame, so they tell the offset between two clocks first
(Furrer et al. 2017 correlate them).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.time_offset import TimedSignal, make_stream
from drivers.errors import CalibrationError

_SPAN_NS = 100_000_000
"""Turns are measured over so long: less is noise, more smooths the motion away."""


def turning_rate(
    time_ns: NDArray[np.int64], quaternions_xyzw: NDArray[np.floating], name: str
) -> TimedSignal:
    """The rate in rad/s about any axis, at the middle of each two orientations 0.1 s apart.

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
    first = np.arange(len(times))
    second = np.searchsorted(times, times + _SPAN_NS)
    first, second = first[second < len(times)], second[second < len(times)]
    near = times[second] - times[first] < 2 * _SPAN_NS
    first, second = first[near], second[near]
    if not len(first):
        raise CalibrationError(f"sync: {name}: no two orientations 0.1 s apart; is the stream too slow?")
    angles = (Rotation.from_quat(values[first]).inv() * Rotation.from_quat(values[second])).magnitude()
    span_s = (times[second] - times[first]) / 1e9
    return make_stream((times[first] + times[second]) // 2, angles / span_s, name)
