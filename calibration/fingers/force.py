"""Force over motor current (or counts beyond contact), where a scale or the arm measured it.

A 3-Finger gripper measures no force; a force request of 0 is its weakest push, not none (manual,
rFR). What was not measured stays unknown.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from calibration.verdict import Assessment, floor, limit
from drivers.errors import CalibrationError

Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class ForceTable:
    """signal (N,) increasing, force_n (N,) not decreasing; misfit_n: rms of the measurements' misses."""

    signal: Array
    force_n: Array
    misfit_n: float
    assessment: Assessment


def fit_force(signal: Array, force_n: Array) -> ForceTable:
    """A monotone table of force over a signal (current or counts beyond contact).

    signal, force_n: (N,). Raises `CalibrationError` for fewer than three different signals or
    numbers that are not finite.
    """
    if signal.shape != force_n.shape or not (np.isfinite(signal).all() and np.isfinite(force_n).all()):
        raise CalibrationError("gripper force: as many finite signals as forces are needed")
    places, where, repeats = np.unique(signal, return_inverse=True, return_counts=True)
    if len(places) < 3:
        raise CalibrationError(f"gripper force: measured at {len(places)} signals, 3 are the least")
    means = np.bincount(where, force_n) / repeats
    fitted = np.asarray(isotonic_regression(means, weights=repeats, increasing=True).x)
    misfit = float(np.sqrt(((force_n - fitted[where]) ** 2).mean()))
    span = float(np.ptp(fitted))
    assessment = limit(
        misfit / max(span, 1e-9), 0.1, 0.3, "forces miss a monotone table by {value:.0%} of its range"
    )
    assessment += floor(len(places), 5, 3, "{value} signals measured; 6 are good")
    return ForceTable(places.astype(np.float64), fitted, misfit, assessment)
