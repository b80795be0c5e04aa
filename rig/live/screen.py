"""The terminal's output: plain text, names of silent phases, and displays that give way to questions.

Names, notes, tags and paths come from files of unknown origin. Escape sequences in them could move the
cursor, hide or rewrite lines, and set the clipboard; bidirectional controls change the order in which a line
is read. So everything printed passes `plain`: `print` and messages by `PlainStream`, tables and displays by
`rig.live.console.PlainConsole`.
"""

import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.live import Live

_ACTING = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]|\r(?!\n)"
)
"""C0 (but tab and line end), DEL, C1, bidirectional and invisible characters, surrogates, tag characters."""
SILENT_S = 0.4
"""Silence before a phase's name is printed: a command prints something within its first second."""
_pending: threading.Timer | None = None
_shown: "list[Live]" = []
"""The displays that are on the terminal now: of this process, which has one terminal."""


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


def begin_phase(name: str) -> None:
    """Print a phase's name on stderr if nothing else is printed for `SILENT_S` from now on.

    The phase of before ends. name: what the command does, as "writing the report".
    """
    global _pending
    end_phase()
    _pending = threading.Timer(SILENT_S, _print_name, [name])
    _pending.daemon = True
    _pending.start()


def end_phase(wait: bool = False) -> None:
    """End the phase, as all other output does. wait: until its thread has ended, as before a fork."""
    global _pending
    timer, _pending = _pending, None
    if timer is not None:
        timer.cancel()
        if wait:
            timer.join()


def _print_name(name: str) -> None:
    with suppress(OSError, ValueError):  # nobody reads any more
        print(f"{name} ...", file=sys.stderr, flush=True)


@contextmanager
def shown(display: "Live") -> Iterator[None]:
    """Show a display, and know of it while it is shown."""
    _start(display)
    _shown.append(display)
    try:
        yield
    finally:
        _shown.remove(display)
        display.stop()


@contextmanager
def set_aside() -> Iterator[None]:
    """Take all displays off the terminal for as long as something is asked there, then show them again."""
    paused = [(display, display.transient, display.vertical_overflow) for display in _shown]
    for display, _, _ in paused:
        display.transient = True  # what is left behind would stand over the question
        display.stop()
    try:
        yield
    finally:
        for display, transient, overflow in paused:
            display.transient, display.vertical_overflow = transient, overflow
            _start(display)


def _start(display: "Live") -> None:
    """Show a display; it takes over both streams and would interpret escape sequences printed there."""
    display.start()
    sys.stdout, sys.stderr = PlainStream(sys.stdout), PlainStream(sys.stderr)  # type: ignore[assignment]
