"""Parameters of a test that run only with `pytest --all`."""

from typing import Any

import pytest


def heavy(*sets: Any) -> list[Any]:
    """Mark sets of parameters as heavy. sets: a value each, or a tuple where there are several arguments."""
    return [pytest.param(*(of if isinstance(of, tuple) else (of,)), marks=pytest.mark.heavy) for of in sets]
