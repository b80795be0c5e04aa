"""TOML 1.0, as bench and object files are written: short, with keys of a few parts."""

import re
import tomllib
from pathlib import Path
from typing import Any

from drivers.errors import FormatError
from drivers.formats.text import read_text, reason

MOST_BYTES = 200_000
_MANY_PARTS = re.compile(r"(?:\.[^.,\n\[\]{}=]*){17}")
"""A key of more than 16 parts: the time that a key takes grows with the square of its parts."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises `FormatError` naming it, and the line."""
    return parse_toml(read_text(path, MOST_BYTES), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the tables of a TOML text. where: its name in errors. Raises `FormatError`."""
    for line in text.split("\n"):
        if not line.lstrip().startswith("#") and _MANY_PARTS.search(line):
            raise FormatError(f"{where}: is no TOML that is read: a key of more than 16 parts: {line[:40]}")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise FormatError(f"{where}: is no TOML that is read: it is nested too deeply") from error
    except ValueError as error:  # tomllib's own, and those of numbers and dates
        raise FormatError(f"{where}: not valid TOML: {reason(error)}") from error
