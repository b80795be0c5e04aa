"""Compile loops with Numba, once per installation; cached beside their file or in the user's cache folder."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Loop = TypeVar("_Loop", bound=Callable[..., object])
# Sums may be computed in another order; NaN stays NaN.
_OPTIONS = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy"}


def compiled(loop: _Loop) -> _Loop:
    """Return a loop that is compiled at its first call; without a writable cache in each process."""
    dispatcher: Any = None
    try:
        dispatcher = numba.njit(cache=True, **_OPTIONS)(loop)
    except RuntimeError:
        dispatcher = numba.njit(**_OPTIONS)(loop)
    return dispatcher
