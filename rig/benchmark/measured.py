"""A measured number and its limit, a table in a document, and the folder of real recordings."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import SupportsFloat

from drivers.errors import InputError

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
            return "-"
        return f"{self.value:.0f}" if abs(self.value) >= 1000.0 else f"{self.value:.3g}"

    @property
    def line(self) -> str:
        """A line of Markdown."""
        return f"- {self.name}: {self.shown}{f' ({self.asked})' if self.asked else ''}"


def at_most(name: str, value: SupportsFloat | None, limit: float) -> Measured:
    """Return a value with an upper limit. value: None, if there were no data, misses the limit."""
    return _within(name, value, float("-inf"), limit, f"at most {limit:g}")


def at_least(name: str, value: SupportsFloat | None, limit: float) -> Measured:
    """Return a value with a lower limit; None misses it."""
    return _within(name, value, limit, float("inf"), f"at least {limit:g}")


def between(name: str, value: SupportsFloat | None, low: float, high: float) -> Measured:
    """Return a value with two limits; None misses them."""
    return _within(name, value, low, high, f"{low:g} to {high:g}")


def informative(name: str, value: SupportsFloat) -> Measured:
    """Return a value without a limit."""
    return Measured(name, float(value), "", None)


def not_there(name: str) -> Measured:
    """Return a row for a measurement whose real recordings are missing."""
    return Measured(name, None, "no recordings here (RIG_TEST_DATA)", None)


def _within(name: str, value: SupportsFloat | None, low: float, high: float, asked: str) -> Measured:
    if value is None:
        return Measured(name, None, asked, False)
    return Measured(name, float(value), asked, low <= float(value) <= high)


def markers(name: str) -> tuple[str, str]:
    """Return the two lines that enclose the table of `rig benchmark NAME` in a document."""
    return f"<!-- rig benchmark {name}: begin -->", f"<!-- rig benchmark {name}: end -->"


def check_readme(path: Path, name: str) -> None:
    """Raise `InputError` unless a file has the two marker lines, once each and in order."""
    begin, end = markers(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if not (text.count(begin) == text.count(end) == 1 and text.index(begin) < text.index(end)):
        raise InputError(f"{path}: put these two lines where the table belongs: {begin} and {end}")


def write_section(path: Path, name: str, section: str) -> None:
    """Replace the lines between the two markers. Raises `InputError` if the markers are missing."""
    check_readme(path, name)
    begin, end = markers(name)
    head, _, rest = path.read_text(encoding="utf-8").partition(begin)
    path.write_text(f"{head}{begin}\n{section}\n{end}{rest.partition(end)[2]}", encoding="utf-8")


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown. A "|" in a cell is written as "/"."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |" for cells in lines)
