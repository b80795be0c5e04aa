"""A measured number and what is asked of it."""

from dataclasses import dataclass
from typing import SupportsFloat


@dataclass(frozen=True, slots=True)
class Measured:
    """A row of a table: met is None where nothing is asked, or nothing was there to measure on."""

    name: str
    value: float | None
    asked: str
    met: bool | None


def at_most(name: str, value: SupportsFloat, limit: float) -> Measured:
    """A number that should not exceed a limit."""
    return Measured(name, float(value), f"at most {limit:g}", float(value) <= limit)


def at_least(name: str, value: SupportsFloat, limit: float) -> Measured:
    """A number that should reach a limit."""
    return Measured(name, float(value), f"at least {limit:g}", float(value) >= limit)


def between(name: str, value: SupportsFloat, low: float, high: float) -> Measured:
    """A number that should lie between two limits."""
    return Measured(name, float(value), f"{low:g} to {high:g}", low <= float(value) <= high)


def informative(name: str, value: SupportsFloat) -> Measured:
    """A number of which nothing is asked."""
    return Measured(name, float(value), "", None)


def not_there(name: str) -> Measured:
    """A row whose real recordings are not there."""
    return Measured(name, None, "no recordings here (RIG_TEST_DATA)", None)
