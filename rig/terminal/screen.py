"""The terminal's output: escaped text, progress of silent phases, displays that are hidden during questions.

Names, notes, tags and paths come from files of unknown origin. Escape sequences in them could move the
cursor, hide or rewrite lines, and set the clipboard; bidirectional controls change the displayed order of a
line. Therefore all output passes through `plain`: `print` and messages in `PlainStream`, tables and displays
in `rig.terminal.tables.PlainConsole`.
"""

import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import RecordingError
from drivers.progress import Display, show_on

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
LEAST_WORK = 0.05
"""Least finished fraction of one piece of work for an estimate of the remaining time."""
MOST_IN_PROGRESS = 0.97
"""Largest finished fraction of work in progress."""
LEAST_S = 1.0
"""Least elapsed time for an estimate: the first report may contain several pieces at once."""
USUAL_PIECES = 10
"""Weight of the pace of an earlier run, in pieces: the first pieces of a run include its start."""
TAIL = 4000
"""Number of printed characters that are kept."""
_phase: "_Phase | None" = None
_shown: "list[Live]" = []
"""The displays of this process that are on the terminal now."""


def plain(text: str) -> str:
    r"""Return a text with control characters escaped as in JSON, such as `\u001b` for an escape character."""
    return _ACTING.sub(
        lambda found: f"\\u{ord(found[0]):04x}" if found[0] < "\U00010000" else f"\\U{ord(found[0]):08x}",
        text,
    )


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
        self._stream.write(plain(text))
        return len(text)


class TimeLeft:
    """The remaining time for `total` pieces of work, of which `done` were finished before the measurement.

    usual_s: time per piece in an earlier run, if known.
    """

    def __init__(
        self, total: int, done: int = 0, clock: Clock | None = None, usual_s: float | None = None
    ) -> None:
        self._clock = clock or SystemClock()
        self._before = done
        self._began_ns = self._clock.now_ns()
        self._newest_ns: int | None = None
        self._usual_s, self._usual_pieces = usual_s or 0.0, USUAL_PIECES if usual_s else 0
        self.total, self.done = total, done

    def begin(self) -> None:
        self._began_ns = self._clock.now_ns()

    def seconds(self, shares: tuple[float, ...] = ()) -> float | None:
        """Return the remaining time, s; None until enough is done. shares: finished fractions in progress."""
        in_progress = sum(min(max(share, 0.0), MOST_IN_PROGRESS) for share in shares)
        worked = self.done - self._before + in_progress
        elapsed_s = (self._clock.now_ns() - self._began_ns) / NS_PER_S if worked else 0.0
        if not self._usual_pieces and (worked < LEAST_WORK or elapsed_s < LEAST_S):
            return None
        pace_s = (elapsed_s + self._usual_s * self._usual_pieces) / (worked + self._usual_pieces)
        return pace_s * max(self.total - self.done - in_progress, 0.0)

    def piece_done(self, done: int, total: int) -> None:
        """Count a finished piece, `done` in total. Time is measured from the end of the first, slower one.

        If fewer pieces are done than before, another part of the work has begun: its pace is measured again.
        """
        now_ns = self._clock.now_ns()
        if self._newest_ns is None or done < self.done:
            self._before, self._began_ns = done, now_ns
        self.done, self.total, self._newest_ns = done, total, now_ns

    def counting_down(self) -> float | None:
        """Return the remaining time at the usual pace, without the progress of the current piece."""
        done = self.done - self._before
        if self._newest_ns is None or done <= 0 or self._newest_ns <= self._began_ns:
            return None
        usual_ns = (self._newest_ns - self._began_ns) / done
        return self.seconds(((self._clock.now_ns() - self._newest_ns) / usual_ns,))


def left_text(seconds: float | None) -> str:
    """Return a remaining time as text: "about 1 min 20 s left", or "" if it is unknown."""
    if seconds is None:
        return ""
    whole = round(seconds)
    if whole < 60:
        return f"about {whole} s left"
    minutes, rest = divmod(whole, 60)
    return f"about {minutes} min {rest} s left" if minutes < 60 else f"about {whole / 3600:.1f} h left"


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
            so_far = f"{elapsed_s:.0f} s so far"
            if self._left is None:
                progress = f"{self._counted} done, {so_far}" if self._counted else so_far
            else:
                left = left_text(self._left.counting_down()) or so_far
                progress = f"{self._left.done} of {self._left.total}, {left}"
            text = plain(f"{self._name}: {progress}")
            self._updating = self._on_terminal
            in_a_line = text[: shutil.get_terminal_size().columns - 1]  # a wrapped line could not be updated
            self._write(f"\r{in_a_line}\x1b[K" if self._on_terminal else f"{text}\n")

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
def show_display(display: "Live") -> Iterator[None]:
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


class Output:
    """A stream of this process whose failure does not end the command.

    If the reader has gone (`| head`), further output is discarded and the command continues its other work.
    needed: whether other write errors, such as a full disk, are raised.
    """

    def __init__(self, stream: TextIO, needed: bool) -> None:
        self._stream, self._needed = stream, needed
        self._newest = ""
        self.reader_gone = False
        """Whether the reader of the stream has closed it."""

    def tail(self) -> str:
        return self._newest

    @property
    def bare(self) -> TextIO:
        """The stream itself. Writing to it does not end a phase."""
        return self._stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        end_phase()
        self._newest = (self._newest + text)[-TAIL:]
        try:
            return self._stream.write(text)
        except OSError as error:
            self._give_up(error)
        return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        discard([self._stream.fileno()])
        self.reader_gone = isinstance(error, BrokenPipeError)
        if self._needed and not isinstance(error, BrokenPipeError):
            raise RecordingError(
                f"the output cannot be written ({error.strerror}); results stored so far are complete"
            ) from error


@contextmanager
def guarded_output() -> Iterator[Output]:
    """Guard both streams against write errors and control characters; yield standard error.

    Raises `RecordingError` if results cannot be written.
    """
    out, err = sys.stdout, sys.stderr
    said = Output(err, needed=False)
    sys.stdout, sys.stderr = PlainStream(Output(out, needed=True)), PlainStream(said)  # type: ignore[assignment]
    try:
        try:
            yield said
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
    finally:
        end_phase()
        sys.stdout, sys.stderr = out, err


def discard(descriptors: list[int]) -> None:
    """Redirect descriptors to the null device, so that writing to a closed terminal is no error."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
