"""Text of others on a terminal: characters that would act on it are shown as escapes instead.

Names, notes, tags and paths come from files of others. Escape sequences in them could move the cursor, hide
or rewrite lines, and set the clipboard; bidirectional controls change the order in which a line is read. All
that is printed goes through `plain`: `print` and messages by `PlainStream`, tables and displays by
`PlainConsole`.
"""

import re
from typing import Any

_ACTING = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]|\r(?!\n)"
)
"""C0 (but tab and line end), DEL, C1, bidirectional and invisible characters, surrogates, tag characters."""


def plain(text: str) -> str:
    r"""Return a text with `\u001b` for an escape character, and so on: escaped as in JSON."""
    return _ACTING.sub(_escaped, text)


def _escaped(found: "re.Match[str]") -> str:
    code = ord(found[0])
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def drawn_stream(stream: Any) -> Any:
    """Return the stream below all others that a program draws on: rich's, too, while it shows a display."""
    while (below := getattr(stream, "rich_proxied_file", None)) is not None:
        stream = below
    return stream


class PlainStream:
    """A stream on which text is shown plainly. Rich, which writes escapes of its own, goes around it."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    @property
    def rich_proxied_file(self) -> Any:
        """Where rich writes: the name under which it looks for that."""
        return drawn_stream(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text plainly; return its length, as streams do."""
        self._stream.write(plain(text))
        return len(text)
