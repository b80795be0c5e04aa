"""Compiles the loops of `rig.tactile.slip.loops` ahead of the first contact."""

from functools import cache
from typing import Any

import numpy as np
from numba.core.event import Listener, install_listener

from drivers.progress import begin_work, count_steps
from rig.tactile.slip.channel import MOST_KEYS, Channel, JointKey
from rig.tactile.slip.compiled import is_cached, loops
from rig.tactile.slip.loops import align_alone, align_jointly, correlation_at, weights_of
from rig.tactile.slip.texture import beyond_noise, summed_tensor

COMPILING_S = 25
"""Duration of the compilation, s; 25 and 29 s of CPU time on a loaded host, with an empty NUMBA_CACHE_DIR."""


class _Report(Listener):
    """Names the work when the first loop is compiled; loops from the cache cause no event."""

    def __init__(self) -> None:
        self._compiled: int | None = None

    def on_start(self, event: Any) -> None:
        """Name the work at the first loop."""
        if self._compiled is None and event.data["dispatcher"] in loops:
            self._compiled = 0
            kept = "once per version" if is_cached(align_alone) else "each time: set NUMBA_CACHE_DIR"
            begin_work(f"compiling the estimator, about {COMPILING_S} s if a core is idle, {kept}")

    def on_end(self, event: Any) -> None:
        """Count a compiled loop."""
        if event.data["dispatcher"] in loops:
            self._compiled = (self._compiled or 0) + 1
            count_steps(self._compiled, len(loops))


@cache
def compile_all() -> None:
    """Compile all loops or load them from the cache, so that the first contact on a bench causes no delay.

    The display of the progress names this if something is compiled, and only then.
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
