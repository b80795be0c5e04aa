"""Parameters of a test that run only with `pytest --long`."""

from typing import Any

import pytest


def long(*sets: Any) -> list[Any]:
    """Mark sets of parameters as long. sets: a value each, or a tuple where there are several arguments."""
    return [pytest.param(*(of if isinstance(of, tuple) else (of,)), marks=pytest.mark.long) for of in sets]
