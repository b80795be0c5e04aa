"""Compile all loops of `slip`, or load them: each is called on small arrays."""

import gc
import os
import sys
from functools import cache
from typing import Any

import numpy as np
from numba.core.registry import cpu_target

from drivers.children import end_with_parent, leave_signals_to_parent
from rig.tactile.slip.compiling import ALL_COMPILED, begin_compiling, cache_folder, wait_until_compiled
from rig.tactile.slip.loops import (
    CURVED,
    FACTS,
    MOST_KEYS,
    MOST_POINTS,
    ROWS,
    SCRATCH,
    Grid,
    Keys,
    Plan,
    Planes,
    align,
    search_grid,
    self_loss,
    weigh,
)
from rig.tactile.slip.pixels import (
    beyond_noise,
    slopes_in,
    strongest_energy,
    subtract_light,
    summed_tensor,
)  # fmt: skip


@cache
def compile_all() -> None:
    """Load all loops, so that the first contact on a bench causes no delay; wait until they are compiled."""
    target: Any = cpu_target
    for _ in range(2):  # the second time if the process that compiled was ended, as its command was
        begin_compiling()
        target.typing_context.refresh()  # loads Numba's own definitions, which takes longer than the loops
        target.target_context.refresh()
        if (folder := cache_folder()) is None or wait_until_compiled(folder):
            break
    _call_one_loop()
    _call_one_half()
    _call_other_half()


def compile_into_cache() -> None:
    """Compile all loops; a fork of this process, which has imported Numba, compiles one half of them."""
    leave_signals_to_parent()
    # Less work: no garbage collection, and no SciPy, which Numba imports for products of matrices.
    gc.disable()
    sys.modules["scipy.linalg"] = None  # pyright: ignore[reportArgumentType]
    _call_one_loop()
    fork = os.fork()
    end_with_parent(sys.stdin.fileno())  # starts a thread, which a fork would not copy
    if fork == 0:
        try:
            _call_one_half()
            os._exit(0)
        finally:
            os._exit(1)
    _call_other_half()
    if os.wait()[1] != 0:
        _call_one_half()
    if (folder := cache_folder()) is not None:
        (folder / ALL_COMPILED).touch()


def _call_one_loop() -> None:
    """Call a loop that `align` shares inner loops with."""
    keys, frame = _keys(), _frame()
    self_loss(keys.bank[0, CURVED], keys.facts[0], frame.slopes, frame.views[0], 0.1)


def _call_one_half() -> None:
    """Call the largest loop, and one more."""
    keys, frame = _keys(), _frame()
    weights = np.zeros((MOST_KEYS, 2, MOST_POINTS), np.float32)
    scratch = np.zeros((MOST_KEYS, 2, SCRATCH, MOST_POINTS), np.float32)
    align(keys, frame, weights, scratch, np.zeros((1, 3)), Plan(1.0, 1.0, 2, 1, 3))
    grid = Grid(1, 0.1, 1, 1, 1)
    search_grid(keys.bank[0, CURVED], keys.facts[0], frame.slopes[0], frame.views[0], np.zeros(3), grid)


def _call_other_half() -> None:
    """Call all other loops, which together take as long to compile."""
    keys, frame = _keys(), _frame()
    planes, mask, work = frame.slopes, np.ones((8, 8), np.uint8), np.zeros((8, 8, 3), np.float32)
    places, begins, image = np.zeros((2, 1), np.int32), np.zeros(2, np.int32), np.zeros((3, 8, 8), np.uint8)
    table = places, begins, places, planes[0, 0]
    subtract_light(image, (0, 0), np.ones((2, 3)), (planes, planes), table, 255, planes)
    slopes_in(work, np.zeros((6, 8, 8), np.float32), 0, 0, np.zeros((8, 8, 2), np.float32))
    summed_tensor(planes, planes.copy())
    beyond_noise(planes, 0.0, (1, 1, 1, 1), planes[0], planes.copy())
    strongest_energy(planes, mask, 1, 0, 0, 1)
    weigh(keys, frame, 0.1, 0.1, np.zeros((MOST_KEYS, 2, MOST_POINTS), np.float32))


def _keys() -> Keys:
    bank = np.zeros((1, 3, ROWS, MOST_POINTS), np.float32)
    return Keys(bank, np.ones((1, FACTS)), np.zeros(1, np.int64))


def _frame() -> Planes:
    planes = np.zeros((4, 8, 8), np.float32)
    return Planes(planes, planes, np.ones((2, 3)))
