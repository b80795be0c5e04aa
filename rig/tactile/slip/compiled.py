"""Compile loops with Numba. All installations of a user share the results: see `_SharedFolder`."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

_Loop = TypeVar("_Loop", bound=Callable[..., object])
# Sums may be computed in another order; NaN stays NaN.
_OPTIONS = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy"}
loops: list[Any] = []
"""All loops of this process. Numba also compiles its helper functions inside them."""


class _SharedFolder(UserWideCacheLocator):
    """A folder in the user's cache that depends on the content of the loops' file, not on its place.

    Numba's own folders depend on the place, so that each installation compiled the same loops again.
    """

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        content = sha256(numba.__version__.encode() + Path(file).read_bytes()).hexdigest()[:16]
        self._cache_path = str(Path(self._cache_path).with_name(f"slip_rig_{content}"))


class _Implementation(CompileResultCacheImpl):
    """Uses the first writable folder: that of NUMBA_CACHE_DIR, the shared one, and the one of the file."""

    _locator_classes = [UserProvidedCacheLocator, _SharedFolder, InTreeCacheLocator]  # noqa: RUF012


class _Cache(FunctionCache):
    _impl_class = _Implementation


def compiled(loop: _Loop) -> _Loop:
    """Return a loop that is compiled at its first call; without a writable cache folder in each process."""
    dispatcher: Any = numba.njit(**_OPTIONS)(loop)
    try:
        dispatcher._cache = _Cache(loop)  # noqa: SLF001  as `cache=True`, which allows no other folders
    except RuntimeError:
        pass
    loops.append(dispatcher)
    return dispatcher


def is_cached(loop: Callable[..., object]) -> bool:
    """Whether the compiled loop is stored for later processes."""
    return isinstance(getattr(loop, "_cache", None), _Cache)
