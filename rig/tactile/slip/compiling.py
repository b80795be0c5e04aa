"""Compiles the loops of `rig.tactile.slip.loops` ahead of the first contact."""

import logging
from functools import cache
from typing import Any

import numpy as np
from numba.core.event import Listener, install_listener

from rig.tactile.slip.channel import MOST_KEYS, Channel, JointKey
from rig.tactile.slip.compiled import is_cached
from rig.tactile.slip.loops import align_alone, align_jointly, correlation_at, weights_of
from rig.tactile.slip.texture import beyond_noise, summed_tensor

COMPILING_S = 20
"""Duration of the compilation on one idle core of 2026 (`compile_all` with an empty NUMBA_CACHE_DIR), s."""


class _Report(Listener):
    """Logs a message when the first loop is compiled; loops from the cache cause no event."""

    def __init__(self) -> None:
        self.compiled = 0

    def on_start(self, event: Any) -> None:
        """Count a loop that is compiled."""
        del event
        self.compiled += 1
        if self.compiled == 1:
            kept = (
                "once per version"
                if is_cached(align_alone)
                else "no cache folder is writable: set NUMBA_CACHE_DIR"
            )
            text = "compiling the estimator, about %d s on an idle core; %s"
            logging.getLogger(__name__).warning(text, COMPILING_S, kept)

    def on_end(self, event: Any) -> None:
        """Ignore the end of a compilation."""


@cache
def compile_all() -> None:
    """Compile all loops or load them from the cache, so that the first contact on a bench causes no delay.

    A warning is logged if something is compiled, and only then.
    """
    with install_listener("numba:compile", _Report()):
        _run_all()


def _run_all() -> None:
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
