"""A signal on one clock, for the estimate of time offsets: made from values or from orientations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

from drivers.errors import CalibrationError, counted

Array = NDArray[np.floating]

FEWEST = 20
"""Fewest samples of a stream, and of the overlap."""
SHORTEST_S, LONGEST_S = 0.2, 1.0
"""Shortest stream, and longest usual interval of its samples; beyond them, times have another unit."""
_SPAN_NS = 100_000_000
"""Interval over which an angular speed is measured: shorter is noisy, longer smooths the motion away."""
_SAME_NS = 100_000
"""Samples in the same interval of this length count once; a stream of 5 kHz keeps all of its samples."""
_AROUND = 15
"""Samples of the running median: more than twice the spikes that one flip of a detector causes."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedSignal:
    """A signal on one clock: time_ns (N,) int64 increasing, values (N,) float64."""

    time_ns: NDArray[np.int64]
    values: Array


def make_stream(time_ns: NDArray[np.int64], values: Array, name: str) -> TimedSignal:
    """Sort samples by time; remove repeated samples (within 0.1 ms), and values that are NaN or infinite.

    name: of the stream, for errors. Raises `CalibrationError` for times that are not integers, shapes that
    differ, a clock that jumps by more than an hour, or fewer than 20 samples.
    """
    times, signal = np.asarray(time_ns), np.asarray(values, np.float64)
    if times.dtype.kind not in "iu" or times.ndim != 1 or times.shape != signal.shape:
        raise CalibrationError(f"sync: {name}: times in integer ns and as many values are needed")
    times = times.astype(np.int64)
    usable = _in_order(times, np.isfinite(signal))
    _require_seconds(times[np.isfinite(signal)], times[usable], name)
    if len(usable) < FEWEST:
        raise CalibrationError(
            f"sync: {name}: {counted(len(usable), 'usable sample')}; at least {FEWEST} are needed"
        )
    longest_s = float(np.diff(times[usable]).max()) / 1e9
    if longest_s > 3600.0:
        raise CalibrationError(f"sync: {name}: its clock jumps by {longest_s / 3600:.1f} h; record again")
    return TimedSignal(times[usable], signal[usable])


def _require_seconds(all_ns: NDArray[np.int64], usable_ns: NDArray[np.int64], name: str) -> None:
    """Raise `CalibrationError` for times of a wrong unit: a short stream, or samples over a second apart."""
    if len(all_ns) < FEWEST:
        return
    lasts_s = float(np.ptp(all_ns)) / 1e9
    interval_s = float(np.median(np.diff(usable_ns))) / 1e9 if len(usable_ns) > 1 else 0.0
    if 0.0 < lasts_s < SHORTEST_S or interval_s > LONGEST_S:
        unit = "ms" if interval_s > LONGEST_S else "microseconds or ms"
        raise CalibrationError(
            f"sync: {name}: {len(all_ns)} samples in {lasts_s:.4g} s: time_ns is in ns and t_s in s; are the "
            f"times in {unit}?"
        )


def turning_rate(
    time_ns: NDArray[np.int64], quaternions_xyzw: NDArray[np.floating], name: str
) -> TimedSignal:
    """Return the angular speed in rad/s over 0.1 s around each time; orientations are interpolated by slerp.

    A robot and a camera on it have the same speed in any frame, so no hand-eye transform is needed (Furrer et
    al. 2017 correlate speeds). time_ns: (N,) int64; quaternions_xyzw: (N, 4), invalid ones are skipped.
    Raises `CalibrationError` if too few valid orientations remain, and as `make_stream` does.
    """
    times, values = np.asarray(time_ns), np.asarray(quaternions_xyzw, np.float64)
    if values.shape != (len(times), 4):
        raise CalibrationError(f"sync: {name}: (N, 4) quaternions for N times are needed, got {values.shape}")
    # the comparison is False for NaN
    usable = _in_order(times, np.abs(np.linalg.norm(values, axis=1) - 1.0) < 0.01)
    times, values = times[usable], values[usable]
    middle = times[_inside(times)] if len(times) else times
    if not len(middle):
        raise CalibrationError(
            f"sync: {name}: no orientations over 0.1 s without a gap; is the stream too slow?"
        )
    turn = Slerp(times - times[0], Rotation.from_quat(values))
    before, after = (turn(middle - times[0] + step) for step in (-_SPAN_NS // 2, _SPAN_NS // 2))
    rates = (before.inv() * after).magnitude() / (_SPAN_NS / 1e9)
    return make_stream(middle, np.where(_spikes(rates), np.nan, rates), name)


def _in_order(times: NDArray[np.int64], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices of usable samples, sorted by time; of samples within `_SAME_NS` the first."""
    found = np.flatnonzero(usable)
    found = found[np.argsort(times[found], kind="stable")]
    _, first = np.unique(times[found] // _SAME_NS, return_index=True)
    return found[first]


def _inside(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether there are samples up to half a span on each side, without a large gap."""
    half = _SPAN_NS // 2
    first, last = np.searchsorted(times, times - half, "right") - 1, np.searchsorted(times, times + half)
    whole = (first >= 0) & (last < len(times))
    wide = np.zeros(len(times), bool)
    wide[whole] = times[last[whole]] - times[first[whole]] < 3 * _SPAN_NS
    return wide


def _spikes(rates: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(N,) whether a rate is an outlier among its neighbours, as when a detector mirrors the target.

    Hampel filter: more than five robust standard deviations from the running median.
    """
    middle = median_filter(rates, _AROUND, mode="nearest")
    away = np.abs(rates - middle)
    usual = median_filter(away, 8 * _AROUND + 1, mode="nearest")
    return away > 5.0 * 1.4826 * usual + 0.05
