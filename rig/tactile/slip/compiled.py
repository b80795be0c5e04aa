"""Compiles loops, by Numba: once an installation, kept beside their file or with the user's caches."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Loop = TypeVar("_Loop", bound=Callable[..., object])
# Sums may be taken in another order; what is not a number stays so.
_OPTIONS = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy"}


def compiled(loop: _Loop) -> _Loop:
    """Return a loop that is compiled when it is first called; each time anew where nothing can be kept."""
    dispatcher: Any = None
    try:
        dispatcher = numba.njit(cache=True, **_OPTIONS)(loop)
    except RuntimeError:
        dispatcher = numba.njit(**_OPTIONS)(loop)
    return dispatcher
