"""Compile loops with Numba, into the folder of `rig.tactile.slip.compiling.cache_folder`."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator

from rig.tactile.slip.compiling import cache_folder

_Loop = TypeVar("_Loop", bound=Callable[..., object])
# Sums may be computed in another order; NaN stays NaN.
_OPTIONS = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy"}


class _Locator(InTreeCacheLocator):
    """Numba's own folders depend on the place of the file: each installation would compile the same loops."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        self._cache_path = str(cache_folder())


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _Cache(FunctionCache):
    _impl_class = _Implementation


def compiled(loop: _Loop) -> _Loop:
    """Return a loop that is compiled at its first call; without a writable cache folder in each process."""
    dispatcher: Any = numba.njit(**_OPTIONS)(loop)
    if cache_folder() is not None:
        dispatcher._cache = _Cache(loop)  # noqa: SLF001  as `cache=True`, which allows no other folders
    return dispatcher
