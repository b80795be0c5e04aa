"""The terminal's output: escaped text, progress of silent phases, displays that are hidden during questions.

Names, notes, tags and paths come from files of unknown origin. Escape sequences in them could move the
cursor, hide or rewrite lines, and set the clipboard; bidirectional controls change the displayed order of a
line. Therefore all output passes through `plain`: `print` and messages in `PlainStream`, tables and displays
in `rig.live.console.PlainConsole`.
"""

import re
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from drivers.progress import Display, show_on
from rig.live.time_left import TimeLeft, left_text

if TYPE_CHECKING:
    from rich.live import Live

_ACTING = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]|\r(?!\n)"
)
"""C0 (except tab and line end), DEL, C1, bidirectional, invisible and tag characters, surrogates."""
SILENT_S = 0.4
"""Time without output after which a phase's name is printed, so that a command prints within a second."""
PROGRESS_S = 2.0
"""Time after which a silent phase shows its progress on a terminal."""
REFRESH_S = 0.5
"""Time between two updates of the progress on a terminal."""
PLAIN_EVERY_S = 10.0
"""Time between two lines of progress in other output."""
_phase: "_Phase | None" = None
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


class _Phase:
    """A silent phase: prints its name, and from `PROGRESS_S` on its progress and the remaining time.

    On a terminal one line is updated; in other output a line is printed every `PLAIN_EVERY_S`. A thread does
    this while nothing is counted. ticking: without it, lines are printed only when a step is counted. left:
    the remaining time of work of which some pieces are finished; the progress is then shown immediately.
    """

    def __init__(self, name: str, ticking: bool, left: TimeLeft | None = None) -> None:
        self._name, self._began = name, time.monotonic()
        stream = drawn_stream(sys.stderr)
        self._stream = getattr(stream, "bare", stream)  # writing to an `Output` ends the phase
        self._on_terminal = self._stream.isatty()
        self._next_s, self._updating, self._named = SILENT_S, False, not ticking
        if not ticking:
            self._next_s = PROGRESS_S if self._on_terminal else PLAIN_EVERY_S
        if left is not None:
            self._named, self._next_s = True, 0.0 if self._on_terminal else PLAIN_EVERY_S
        self._left, self._counted = left, 0
        self._lock, self._ended = threading.RLock(), threading.Event()
        self.thread = threading.Thread(target=self._tick, daemon=True) if ticking else None
        if self.thread is not None:
            self.thread.start()

    def count(self, done: int, total: int | None) -> None:
        """Note the number of finished steps and of all steps, None if unknown."""
        with self._lock:
            if total is None:
                self._left = None
            elif self._left is None or done == 0:
                self._left = TimeLeft(total, done)
            if self._left is not None and done:
                self._left.piece_done(done, self._left.total)
            self._counted = done
        self._print_if_due()

    def end(self) -> None:
        """Remove the line from a terminal. Nothing is printed afterwards."""
        with self._lock:
            self._ended.set()
            if self._updating:
                self._write("\r\x1b[K")

    def _tick(self) -> None:
        while not self._ended.wait(max(self._next_s - self._elapsed_s(), 0.01)):
            self._print_if_due()

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def _print_if_due(self) -> None:
        with self._lock:
            elapsed_s = self._elapsed_s()
            if self._ended.is_set() or elapsed_s < self._next_s:
                return
            if not self._named:
                self._named, self._next_s = True, PROGRESS_S if self._on_terminal else PLAIN_EVERY_S
                self._write(f"{plain(self._name)} ...\n")
                return
            self._next_s = elapsed_s + (REFRESH_S if self._on_terminal else PLAIN_EVERY_S)
            text = plain(f"{self._name}: {self._progress(elapsed_s)}")
            self._updating = self._on_terminal
            in_a_line = text[: shutil.get_terminal_size().columns - 1]  # a wrapped line could not be updated
            self._write(f"\r{in_a_line}\x1b[K" if self._on_terminal else f"{text}\n")

    def _progress(self, elapsed_s: float) -> str:
        left = "" if self._left is None else left_text(self._left.counting_down())
        if self._left is None:
            counted = f"{self._counted} done, " if self._counted else ""
            return f"{counted}{elapsed_s:.0f} s so far"
        return f"{self._left.done} of {self._left.total}, {left or f'{elapsed_s:.0f} s so far'}"

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the reader has gone
            self._stream.write(text)
            self._stream.flush()


def begin_phase(name: str, ticking: bool = True, left: TimeLeft | None = None) -> None:
    """Show a phase's name and progress on stderr while nothing else is printed. The previous phase ends.

    name: description of the work, such as "writing the report". Loops of the phase count their steps with
    `drivers.progress.steps`. ticking: False if the phase forks, because a fork must not copy a thread. left:
    the remaining time, if the phase continues work of which some pieces are finished.
    """
    global _phase
    end_phase()
    _phase = _Phase(name, ticking, left)
    show_on(Display(begin_phase, _phase.count))


def end_phase(wait: bool = False) -> None:
    """End the phase, as any other output does. wait: join its thread, as needed before a fork."""
    global _phase
    phase, _phase = _phase, None
    if phase is not None:
        show_on(None)
        phase.end()
        if wait and phase.thread is not None:
            phase.thread.join()


@contextmanager
def shown(display: "Live") -> Iterator[None]:
    """Show a display, and register it meanwhile, so that `set_aside` can hide it."""
    end_phase()
    _start(display)
    _shown.append(display)
    try:
        yield
    finally:
        _shown.remove(display)
        display.stop()


@contextmanager
def set_aside() -> Iterator[None]:
    """End the phase, and hide all displays during a question, then show them again."""
    end_phase()
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
