"""The terminal's output: escaped text, names of silent phases, and displays that are hidden during questions.

Names, notes, tags and paths come from files of unknown origin. Escape sequences in them could move the
cursor, hide or rewrite lines, and set the clipboard; bidirectional controls change the displayed order of a
line. Therefore all output passes through `plain`: `print` and messages in `PlainStream`, tables and displays
in `rig.live.console.PlainConsole`.
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
"""C0 (except tab and line end), DEL, C1, bidirectional, invisible and tag characters, surrogates."""
SILENT_S = 0.4
"""Time without output after which a phase's name is printed, so that a command prints within a second."""
_pending: threading.Timer | None = None
_shown: "list[Live]" = []
"""The displays of this process that are on the terminal now."""


def plain(text: str) -> str:
    r"""Return a text with control characters escaped as in JSON, such as `\u001b` for an escape character."""
    return _ACTING.sub(_escaped, text)


def _escaped(found: "re.Match[str]") -> str:
    code = ord(found[0])
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def drawn_stream(stream: Any) -> Any:
    """Return the underlying stream, below those of this module and of rich."""
    while (below := getattr(stream, "rich_proxied_file", None)) is not None:
        stream = below
    return stream


class PlainStream:
    """A stream that escapes control characters. Rich writes past it, because it needs control sequences."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    @property
    def rich_proxied_file(self) -> Any:
        """The stream that rich writes to; rich looks for this attribute."""
        return drawn_stream(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write an escaped text; return the length of the text."""
        self._stream.write(plain(text))
        return len(text)


def begin_phase(name: str) -> None:
    """Print a phase's name on stderr if nothing else is printed within `SILENT_S`.

    The previous phase ends. name: description of the work, such as "writing the report".
    """
    global _pending
    end_phase()
    _pending = threading.Timer(SILENT_S, _print_name, [name])
    _pending.daemon = True
    _pending.start()


def end_phase(wait: bool = False) -> None:
    """End the phase, as any other output does. wait: join its thread, as needed before a fork."""
    global _pending
    timer, _pending = _pending, None
    if timer is not None:
        timer.cancel()
        if wait:
            timer.join()


def _print_name(name: str) -> None:
    with suppress(OSError, ValueError):  # the reader has gone
        print(f"{name} ...", file=sys.stderr, flush=True)


@contextmanager
def shown(display: "Live") -> Iterator[None]:
    """Show a display, and register it meanwhile, so that `set_aside` can hide it."""
    _start(display)
    _shown.append(display)
    try:
        yield
    finally:
        _shown.remove(display)
        display.stop()


@contextmanager
def set_aside() -> Iterator[None]:
    """Hide all displays during a question, then show them again."""
    paused = [(display, display.transient, display.vertical_overflow) for display in _shown]
    for display, _, _ in paused:
        display.transient = True  # otherwise its last state would remain above the question
        display.stop()
    try:
        yield
    finally:
        for display, transient, overflow in paused:
            display.transient, display.vertical_overflow = transient, overflow
            _start(display)


def _start(display: "Live") -> None:
    """Show a display. It replaces both streams by its own, so wrap them again in `PlainStream`."""
    display.start()
    sys.stdout, sys.stderr = PlainStream(sys.stdout), PlainStream(sys.stderr)  # type: ignore[assignment]
