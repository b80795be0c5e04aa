"""What pages are made of: notices, charts and tables."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup


@dataclass(frozen=True, slots=True)
class Notice:
    """Something the reader should know: what was seen, and what to do about it.

    level: "bad" (figures are missing or wrong), "warn" (they mean less than they seem), "good".
    """

    level: str
    what: str
    advice: str


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure with its title and what it shows."""

    title: str
    svg: Markup
    caption: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table of ready text. text: columns that hold words; total: whether the last row sums up."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    text: Sequence[int] = (0,)
    total: bool = False


def joined(items: Sequence[str], most: int = 4) -> str:
    """List things in a sentence, the first few of many."""
    shown = list(items[:most])
    if len(items) > most:
        shown.append(f"{len(items) - most} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + f" and {shown[-1]}" if shown else ""
