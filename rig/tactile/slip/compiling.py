"""Compiles the loops of `rig.tactile.slip.loops` ahead of the first contact, on two cores.

If a loop is not in the cache, a child process compiles one half of the loops while this one compiles the
other half.
"""

import fcntl
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba.core.event import Listener, install_listener

from drivers.children import python_command
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

COMPILING_S = 12
"""Duration of the compilation on two idle cores, s: 12.3 and 12.5 s in two runs with an empty cache. One
process took 14.4 and 17.9 s on the same computer."""
OTHER_HALF_S = 120.0
"""Time limit for the child process, s. If it is reached, this process compiles the rest."""


class _Report(Listener):
    """Reports when the first loop is compiled, and begins `_other_half` then.

    Loops from the cache cause no event. begun: ends the other half.
    """

    def __init__(self, begun: ExitStack) -> None:
        self._compiled: int | None = None
        self._begun = begun

    def on_start(self, event: Any) -> None:
        """Name the work at the first loop."""
        if self._compiled is None and event.data["dispatcher"] in loops:
            self._compiled = 0
            cached = is_cached(align)
            again = "once per version" if cached else "each time: set NUMBA_CACHE_DIR"
            begin_work(f"compiling the estimator, about {COMPILING_S} s if two cores are idle, {again}")
            with suppress(OSError):
                if cached:
                    self._begun.enter_context(_other_half(Path(event.data["dispatcher"].stats.cache_path)))

    def on_end(self, event: Any) -> None:
        """Count a compiled loop."""
        if event.data["dispatcher"] in loops:
            self._compiled = (self._compiled or 0) + 1
            count_steps(self._compiled, None)


@cache
def compile_all() -> None:
    """Compile all loops or load them from the cache, so that the first contact on a bench causes no delay.

    The display of the progress names this if something is compiled, and only then.
    """
    with ExitStack() as begun, install_listener("numba:compile", _Report(begun)):
        compile_half()
        begun.close()
        compile_other_half()


@contextmanager
def _other_half(cache_folder: Path) -> Iterator[None]:
    """Compile the other half in a child process; at the end of the block it is in the cache.

    If another process compiles already, wait until it has filled the cache. Raises `OSError`.
    """
    with (cache_folder / "compiling.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
            return
        code = f"from {__name__} import compile_other_half; compile_other_half()"
        quiet = subprocess.DEVNULL
        command = python_command("-c", code)
        child = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)  # noqa: S603
        try:
            yield
            with suppress(subprocess.TimeoutExpired):
                child.wait(OTHER_HALF_S)
        finally:
            child.kill()
            child.wait()


def compile_half() -> None:
    """Compile or load one half of the loops; the first one takes the least time."""
    planes, views, facts = np.zeros((4, 8, 8), np.float32), np.ones((2, 3)), np.ones((1, FACTS))
    bank = np.zeros((1, 3, ROWS, MOST_POINTS), np.float32)
    kept(bank[0, 0], facts[0], planes, views[0], 0.1)
    weights = np.zeros((MOST_KEYS, 2, MOST_POINTS), np.float32)
    scratch = np.zeros((MOST_KEYS, 2, SCRATCH, MOST_POINTS), np.float32)
    align(
        bank, facts, np.zeros(1, np.int64), planes, planes, views, weights, scratch, np.zeros((1, 3)), 1.0,
        1.0, 2, 1, 3, np.zeros(RESULTS),
    )  # fmt: skip


def compile_other_half() -> None:
    """Compile or load the other half of the loops."""
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
    weigh(bank, facts, np.zeros(1, np.int64), planes, planes, views, 0.1, 0.1, weights)
    sought(bank[0, CURVED], facts[0], planes[0], views[0], np.zeros(3), 1, 0.1, 1, 1, 1)
