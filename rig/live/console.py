"""The console of all tables, bars and displays. It shows text from files as it is, without markup."""

import sys
from collections.abc import Iterable
from typing import IO, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from rig.live.screen import drawn_stream, plain


class PlainConsole(Console):
    """A rich console that shows square brackets and `:names:` as text and escapes control characters."""

    def __init__(self, *, file: IO[str] | None = None, stderr: bool = False, **options: Any) -> None:
        stream = file or drawn_stream(sys.stderr if stderr else sys.stdout)
        super().__init__(file=stream, markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as it is shown, so that its width is measured correctly."""
        return super().render_str(plain(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with `plain` applied to all but rich's own control sequences."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(plain(segment.text), segment.style)
