"""A measured number and its limit, and the folder of real recordings."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import SupportsFloat

NONE = "-"  # a cell without a value
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Folder of real recordings, unless RIG_TEST_DATA names another one."""


def data_folder() -> Path | None:
    """Return the folder of real recordings, or None if it does not exist."""
    folder = Path(os.environ.get("RIG_TEST_DATA", DATA))
    return folder if folder.is_dir() else None


@dataclass(frozen=True, slots=True)
class Measured:
    """A measured value and its limit: a row of a table. met: None without a limit or without data."""

    name: str
    value: float | None
    asked: str
    met: bool | None

    @property
    def shown(self) -> str:
        """The value with three digits, or as a whole number; "-" without a value."""
        if self.value is None:
            return NONE
        return f"{self.value:.0f}" if abs(self.value) >= 1000.0 else f"{self.value:.3g}"


def between(name: str, value: SupportsFloat | None, low: float, high: float, asked: str = "") -> Measured:
    """Return a value with two limits; None, if there were no data, misses them."""
    asked = asked or f"{low:g} to {high:g}"
    if value is None:
        return Measured(name, None, asked, False)
    return Measured(name, float(value), asked, low <= float(value) <= high)


def at_most(name: str, value: SupportsFloat | None, limit: float) -> Measured:
    return between(name, value, float("-inf"), limit, f"at most {limit:g}")


def at_least(name: str, value: SupportsFloat | None, limit: float) -> Measured:
    return between(name, value, limit, float("inf"), f"at least {limit:g}")


def informative(name: str, value: SupportsFloat) -> Measured:
    return Measured(name, float(value), "", None)


def not_there(name: str) -> Measured:
    return Measured(name, None, "no recordings here (RIG_TEST_DATA)", None)
