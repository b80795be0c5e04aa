"""Compiles loops, by Numba: once an installation, kept beside their file or with the user's caches."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Loop = TypeVar("_Loop", bound=Callable[..., object])
# Sums may be computed in another order; NaN stays NaN.
_OPTIONS = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy"}


def compiled(loop: _Loop) -> _Loop:
    """Return a loop that is compiled when first called: in each process if no cache is writable."""
    dispatcher: Any = None
    try:
        dispatcher = numba.njit(cache=True, **_OPTIONS)(loop)
    except RuntimeError:
        dispatcher = numba.njit(**_OPTIONS)(loop)
    return dispatcher
