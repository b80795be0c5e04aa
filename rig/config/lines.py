"""The line of a TOML file that a key is on, for messages that say where something is wrong."""

import tomllib
from collections.abc import Sequence
from typing import Any

KeyPath = Sequence[str | int]
"""Keys and list indices from the top of a bench file, as ("tactile", 1, "rate_hz")."""
KeyFault = tuple[KeyPath, str]
"""A key, and what is wrong with it."""


def line_of(text: str, path: KeyPath) -> int:
    """Return the 1-based line on which a key, table or element of valid TOML begins.

    What is not in the text (a missing key) counts as being where its nearest table begins; an empty
    path is line 1.

    The file is read again from its beginning, a line more each time, until the key is there: no
    second idea of TOML's grammar is needed, and bench files are short.
    """
    lines = text.splitlines()
    wanted = _present_part(tomllib.loads(text), path)
    readable = 0
    for count in range(1, len(lines) + 1):
        try:
            document = tomllib.loads("\n".join(lines[:count]))
        except tomllib.TOMLDecodeError:
            continue  # in the middle of a value of several lines
        if wanted and _present_part(document, wanted) == wanted:
            return _first_with_content(lines, readable)
        readable = count
    return 1


def _present_part(document: Any, path: KeyPath) -> list[str | int]:
    """Return as much of a path as leads to something."""
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
    """Number of the first line from index `start` on that is neither empty nor a comment."""
    content = (
        i for i in range(start, len(lines)) if lines[i].strip() and not lines[i].lstrip().startswith("#")
    )
    return next(content) + 1
