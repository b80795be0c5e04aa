"""The noise of pose pairs: six standard deviations of robot and detector, found from the residuals.

A target's pose is known well across the view and badly in depth and tilt; a robot's turn moves a far
target far. Which of both counts more differs from set to set by a factor of a hundred, so it is estimated
(restricted maximum likelihood of Gaussian residuals), with a wide prior that decides where few poses do not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.floating]

_USUAL = np.array([np.radians(0.03), 3e-4, np.radians(0.2), np.radians(0.2), 1e-3, 3e-3])
"""Robot: turn (rad), place (m). Detector: tilt, turn about the axis (rad), across, depth (m)."""
_WIDE = np.array([1.2, 1.2, 2.5, 2.5, 2.5, 2.5])
"""One sigma of the prior of each one's logarithm."""
_LEAST, _MOST = 1e-3, 1e3


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """parts: (6, N, 6, 6), the covariance of each pair's residual for one unit of each deviation."""

    parts: Array

    def covariances(self, sigmas: Array) -> Array:
        """(N, 6, 6) of the residuals for (6,) standard deviations."""
        return np.einsum("k,knij->nij", sigmas**2, self.parts)


def noise_model(robot: Array) -> NoiseModel:
    """robot: (N, 6, 6), what a twist of the robot (turn, move) does to the residual (turn, move)."""
    parts = [robot[:, :, axes] @ robot[:, :, axes].transpose(0, 2, 1) for axes in (slice(3), slice(3, 6))]
    for axes in ([0, 1], [2], [3, 4], [5]):
        part = np.zeros((6, 6))
        part[axes, axes] = 1.0
        parts.append(np.broadcast_to(part, (len(robot), 6, 6)))
    return NoiseModel(np.array(parts))


def fit_noise(model: NoiseModel, residuals: Array, weights: Array, parameters: int, start: Array) -> Array:
    """(6,) standard deviations that explain (N, 6) residuals best, counted with (N,) weights.

    parameters: how many were fitted to the residuals, which made them smaller.
    """
    count = residuals.size
    quadratic = weights * count / max(count - parameters, 1)

    def cost(logs: Array) -> tuple[float, Array]:
        sigmas = _USUAL * np.exp(logs)
        covariances = model.covariances(sigmas)
        inverse = np.linalg.inv(covariances)
        white = (inverse @ residuals[..., None])[..., 0]
        value = 0.5 * np.linalg.slogdet(covariances)[1].sum()
        value += 0.5 * float(quadratic @ (residuals * white).sum(axis=1))
        by_part = np.einsum("nij,knji->k", inverse, model.parts)
        by_part -= np.einsum("n,ni,knij,nj->k", quadratic, white, model.parts, white)
        prior = logs / _WIDE**2
        return value + 0.5 * float(logs @ prior), sigmas**2 * by_part + prior

    limits = [(np.log(_LEAST), np.log(_MOST))] * len(_USUAL)
    found = minimize(cost, np.log(start / _USUAL), jac=True, method="L-BFGS-B", bounds=limits)
    return _USUAL * np.exp(found.x)


def usual_noise() -> Array:
    """(6,) where the search starts."""
    return _USUAL.copy()
