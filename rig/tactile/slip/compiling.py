"""Compiles the loops of `rig.tactile.slip.loops` ahead of the first contact."""

import logging
import threading
from functools import cache

import numpy as np

from rig.tactile.slip.channel import MOST_KEYS, Channel, JointKey
from rig.tactile.slip.loops import align_alone, align_jointly, correlation_at, weights_of
from rig.tactile.slip.texture import beyond_noise, summed_tensor

# Compiling that takes longer is reported.
REPORTED_AFTER_S = 3.0


@cache
def compile_all() -> None:
    """Compile all loops or load them from the cache, so that the first contact on a bench causes no delay."""
    report = threading.Timer(REPORTED_AFTER_S, _report)
    report.daemon = True
    report.start()
    planes, point = np.zeros((8, 8, 3), np.float32), np.zeros(1, np.complex64)
    ones, none = np.ones(1, np.float32), np.zeros((6, 3, 1), np.float32)
    slopes = Channel(
        planes, point, 3.5 + 3.5j, none[0, :2], ones, np.ascontiguousarray(none[:, :2]), turns=1.0
    )
    texture = Channel(planes, point, 3.5 + 3.5j, none[0], ones, none[:3], turns=2.0)
    both = slopes, weights_of(slopes, 1.0, 1.0), texture, weights_of(texture, 1.0, 1.0)
    align_alone(slopes, ones, 1.0, (0.0, 0j), 1, False)
    correlation_at(*both[:2], 0.0, 0j)
    correlation_at(*both[2:], 0.0, 0j)
    key = JointKey(*both, 1.0, 0.0, 0j)
    align_jointly((key,) * MOST_KEYS, (0.0, 0j), 0.0, 1.0, (1.0, 1.0), 1)
    beyond_noise(summed_tensor(planes, planes), planes[..., 0].copy(), 0.0, 1)
    report.cancel()


def _report() -> None:
    logging.getLogger(__name__).warning("compiling the estimator's inner loops, once per installation")
