"""Find the line of a key in a TOML file, for error messages."""

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

from drivers.errors import FormatError
from drivers.formats import parse_toml

MOST_LINES = 500
"""Most lines of a bench file that are searched for a key: the time grows with the square of the lines."""

KeyPath = Sequence[str | int]
"""Keys and list indices from the top of a bench file, such as ("tactile", 1, "rate_hz")."""
KeyFault = tuple[KeyPath, str]
"""A key and its problem."""


def line_of(text: str, path: KeyPath) -> int:
    """Return the 1-based line on which a key, table or element of valid TOML begins.

    A missing key counts as being on the line where its nearest table begins. An empty path is line 1, and so
    are keys beyond `MOST_LINES`.

    The file is parsed repeatedly with one more line until the key exists: this needs no second TOML grammar,
    and bench files are short.
    """
    wanted = _present_part(parse_toml(text, ""), path)
    for begin, document in _grown(text) if wanted else ():
        if _present_part(document, wanted) == wanted:
            return _first_with_content(text.split("\n"), begin)
    return 1


@lru_cache(maxsize=1)
def _grown(text: str) -> list[tuple[int, Any]]:
    """Return the document up to each line, with the number of lines before its last statement."""
    lines, readable = text.split("\n"), 0
    grown: list[tuple[int, Any]] = []
    for count in range(1, min(len(lines), MOST_LINES) + 1):
        if not lines[count - 1].strip() or lines[count - 1].lstrip().startswith("#"):
            continue
        with suppress(FormatError):  # in the middle of a multi-line value
            grown.append((readable, parse_toml("\n".join(lines[:count]), "")))
            readable = count
    return grown


def _present_part(document: Any, path: KeyPath) -> list[str | int]:
    """Return the longest existing prefix of a path."""
    found: list[str | int] = []
    for step in path:
        if isinstance(document, dict) and step in document:
            document = document[step]
        elif isinstance(document, list) and isinstance(step, int) and step < len(document):
            document = document[step]
        else:
            break
        found.append(step)
    return found


def _first_with_content(lines: list[str], start: int) -> int:
    """Return the number of the first line from index `start` on that is neither empty nor a comment."""
    content = (
        i for i in range(start, len(lines)) if lines[i].strip() and not lines[i].lstrip().startswith("#")
    )
    return next(content) + 1
