"""Tests that run only with `pytest --all`, or only with an optional library."""

from importlib.util import find_spec
from typing import Any

import pytest


def heavy(*sets: Any) -> list[Any]:
    """Mark sets of parameters as heavy. sets: a value each, or a tuple where there are several arguments."""
    return [pytest.param(*(of if isinstance(of, tuple) else (of,)), marks=pytest.mark.heavy) for of in sets]


def require_ur_rtde() -> None:
    """Skip a test, or the rest of a file, if the arm's library is not installed."""
    if find_spec("rtde_control") is None:
        reason = "ur-rtde is not installed: its wheels are for Linux on x86-64, Python 3.11 and 3.12"
        pytest.skip(reason, allow_module_level=True)
