"""Tables that are never cut: folded to the width of a terminal, of full width in other output.

A table that is too wide for a terminal is folded at spaces. If that is not sufficient, each row becomes
several lines of "heading value". Nothing is left out, and words, such as a session's name, are never broken.
Texts from files are shown as they are, without markup.
"""

import sys
from collections.abc import Collection, Iterable, Sequence
from textwrap import wrap
from typing import IO, Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from rig.terminal.screen import drawn_stream, plain

UNBOUNDED = 100_000
"""Width of the output if it is not a terminal."""


class PlainConsole(Console):
    """A rich console that shows square brackets and `:names:` as text and escapes control characters.

    Printed tables are fitted to its width.
    """

    def __init__(self, *, file: IO[str] | None = None, stderr: bool = False, **options: Any) -> None:
        stream = file or drawn_stream(sys.stderr if stderr else sys.stdout)
        super().__init__(file=stream, markup=False, emoji=False, **options)

    def print(self, *objects: Any, **options: Any) -> None:
        if any(isinstance(each, Table) for each in objects):
            options = {"crop": False, **options}
        super().print(*(fit(o, self) if isinstance(o, Table) else o for o in objects), **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as it is shown, so that its width is measured correctly."""
        return super().render_str(plain(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with `plain` applied to all but rich's own control sequences."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(plain(segment.text), segment.style)


def table_console(to_stderr: bool = False) -> Console:
    """Return a console for tables, as wide as the terminal, or of unlimited width without a terminal."""
    terminal = (sys.stderr if to_stderr else sys.stdout).isatty()
    return PlainConsole(stderr=to_stderr, width=None if terminal else UNBOUNDED)


def console_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: Collection[int] = (0,),
    title: str | None = None,
) -> Table:
    """Return a table. left: indices of the left-aligned columns; the others are right-aligned."""
    table = Table(title=title)
    for place, column in enumerate(columns):
        table.add_column(column, justify="left" if place in left else "right")
    for row in rows:
        table.add_row(*row)
    return table


def fit(table: Table, console: Console) -> Table | Group:
    """Return a table that is at most as wide as the console, or the same content as lines."""
    room = console.width - 3 * len(table.columns) - 1
    columns = [[_text(cell) for cell in (column.header, *column.cells)] for column in table.columns]
    widths = _fold(columns, room)
    if widths is None:
        return _lines(table, columns)
    for column, width in zip(table.columns, widths, strict=True):
        column.width, column.no_wrap, column.overflow = width, False, "fold"
    return table


def _fold(columns: Sequence[Sequence[Text]], room: int) -> list[int] | None:
    """Return the column widths that fit with the fewest lines per row; None if none fit."""
    for height in range(1, 1 + max(len(text.plain.split()) for cells in columns for text in cells)):
        widths = [_narrowest(cells, height) for cells in columns]
        if sum(widths) <= room:
            return _unfold(columns, widths, room)
    return None


def _unfold(columns: Sequence[Sequence[Text]], widths: list[int], room: int) -> list[int]:
    """Use the remaining width for columns that then need fewer lines, those that need least width first."""
    while True:
        wider = {}
        for i, (cells, width) in enumerate(zip(columns, widths, strict=True)):
            height = max(_height(text, width) for text in cells)
            if height > 1:
                wider[i] = _narrowest(cells, height - 1)
        cheapest = min(wider, key=lambda i: wider[i] - widths[i], default=None)
        if cheapest is None or sum(widths) - widths[cheapest] + wider[cheapest] > room:
            return widths
        widths[cheapest] = wider[cheapest]


def _narrowest(cells: Sequence[Text], height: int) -> int:
    """Return the smallest width at which every cell has at most `height` lines."""
    width = max((cell_len(word) for text in cells for word in text.plain.split()), default=0)
    while max(_height(text, width) for text in cells) > height:
        width += 1
    return width


def _height(text: Text, width: int) -> int:
    return sum(len(wrap(line, width, break_on_hyphens=False)) or 1 for line in text.plain.split("\n"))


def _lines(table: Table, columns: Sequence[Sequence[Text]]) -> Group:
    """Write each row as its first cell, followed by a line per other cell with its heading."""
    heads = [cells[0].plain.replace("\n", " ") for cells in columns]
    lines: list[RenderableType] = [Text(str(table.title))] if table.title else []
    for row in zip(*(cells[1:] for cells in columns), strict=True):
        rest = [f"{head} {cell.plain}".strip() for head, cell in zip(heads, row, strict=True) if cell.plain]
        first, others = (rest[0], rest[1:]) if row[0].plain else ("", rest)
        name = Text(first.removeprefix(f"{heads[0]} "), no_wrap=True, overflow="ignore")
        lines += [name, Padding(Text("; ".join(others)), (0, 0, 0, 2))]
    return Group(*lines)


def _text(cell: Any) -> Text:
    return Text(plain(cell.plain if isinstance(cell, Text) else str(cell)))
