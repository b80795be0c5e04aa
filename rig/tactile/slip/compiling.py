"""Compiles the loops of `rig.tactile.slip.loops` ahead of the first contact."""

from functools import cache
from typing import Any

import numpy as np
from numba.core.event import Listener, install_listener

from drivers.progress import begin_work, count_steps
from rig.tactile.slip.compiled import is_cached, loops
from rig.tactile.slip.loops import (
    CURVED,
    FACTS,
    MOST_KEYS,
    MOST_POINTS,
    RESULTS,
    ROWS,
    SCRATCH,
    align,
    kept,
    sought,
    weigh,
)  # fmt: skip
from rig.tactile.slip.pixels import (
    beyond_noise,
    divergence,
    fit_light,
    lit,
    slopes_in,
    strongest_energy,
    summed_tensor,
    without_broad,
)  # fmt: skip

COMPILING_S = 11
"""Duration of the compilation, s: 10.3 to 10.7 s of CPU time in three runs with an empty NUMBA_CACHE_DIR."""


class _Report(Listener):
    """Names the work when the first loop is compiled; loops from the cache cause no event."""

    def __init__(self) -> None:
        self._compiled: int | None = None

    def on_start(self, event: Any) -> None:
        """Name the work at the first loop."""
        if self._compiled is None and event.data["dispatcher"] in loops:
            self._compiled = 0
            kept = "once per version" if is_cached(align) else "each time: set NUMBA_CACHE_DIR"
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
    planes, work, mask = (
        np.zeros((4, 8, 8), np.float32),
        np.zeros((8, 8, 3), np.float32),
        np.ones((8, 8), np.uint8),
    )
    few, pairs, views = np.ones((3, 4)), np.zeros((8, 8, 2), np.float32), np.ones((2, 3))
    fit_light(few, few, few, 1, 1, 0.01, 1e-3, 0.02, np.ones((2, 3)))
    places, begins, image = np.zeros((2, 1), np.int32), np.zeros(2, np.int32), np.zeros((3, 8, 8), np.uint8)
    lit(image, 0, 0, np.ones((2, 3)), planes, planes, places, begins, places, planes[0, 0], 255, planes)
    slopes_in(work, np.zeros((6, 8, 8), np.float32), 0, 0, pairs)
    without_broad(pairs, pairs, 1.0, mask, 0, 0, planes)
    divergence(pairs, planes[0].copy())
    summed_tensor(planes, planes.copy())
    beyond_noise(planes, 0.0, (1, 1, 1, 1), planes[0], planes.copy())
    strongest_energy(planes, mask, 1, 0, 0, 1)
    bank, facts = np.zeros((1, 3, ROWS, MOST_POINTS), np.float32), np.ones((1, FACTS))
    weights = np.zeros((MOST_KEYS, 2, MOST_POINTS), np.float32)
    scratch = np.zeros((MOST_KEYS, 2, SCRATCH, MOST_POINTS), np.float32)
    used = np.zeros(1, np.int64)
    weigh(bank, facts, used, planes, planes, views, 0.1, 0.1, weights)
    align(
        bank, facts, used, planes, planes, views, weights, scratch, np.zeros((1, 3)), 0.0, 1.0, 1.0,
        1.0, 1.0, 2, 1, 3, np.zeros(RESULTS),
    )  # fmt: skip
    kept(bank[0, 0], facts[0], planes, views[0], 0.1)
    sought(bank[0, CURVED], facts[0], planes[0], views[0], np.zeros(3), 1, 0.1, 1, 1, 1)
