"""Questions to the person at the terminal; displays are hidden until the answer.

Only input typed after a question answers it. The log of a session has each question with its answer and
time. Standard input and standard error must be a terminal, so that the person sees the question and can
answer.
"""

import logging
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.errors import OperatorStopError
from rig.terminal.onlookers import announce_question

_log = logging.getLogger("rig.terminal.questions")


def ask(question: str) -> bool:
    """Ask a yes-or-no question; without a terminal the answer is no."""
    if not _terminal():
        print(f"{question} [no terminal to ask and answer at: no]", file=sys.stderr, flush=True)
        return False
    while (answer := _read_line(f"{question} [y/N]:").strip()) not in ("", "n", "no", "y", "yes"):
        print(f"'{answer}' is neither y nor n", file=sys.stderr, flush=True)
    return answer in ("y", "yes")


def ask_line(question: str) -> str:
    """Ask for a line of text. Raises `OperatorStopError` at the end of input, and without a terminal."""
    _require_terminal(question, "ask and answer")
    line = _read_line(question)
    if not line:
        raise OperatorStopError("stopped: the input ended without an answer; the arm holds its position")
    return line.strip()


@contextmanager
def show_question(question: str) -> Iterator[Callable[[], bool]]:
    """Show a question while other work goes on; yield a function that returns whether Enter was pressed.

    The function raises `OperatorStopError` for "q" and if the terminal has gone; so does a missing terminal.
    """
    _require_terminal(question, "ask and answer")

    def is_answered() -> bool:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return False
        line = sys.stdin.readline()
        if not line or line.strip().lower() in ("q", "quit", "stop"):
            raise OperatorStopError("stopped by the operator; the arm holds its position")
        _log.info("%s answered: Enter", question)
        return True

    with announce_question(question):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        print(question, file=sys.stderr, flush=True)
        yield is_answered


def press(question: str) -> str:
    """Return the next key that is pressed, "enter" for Enter; keys pressed before the call are discarded.

    question: shown first unless it is empty. Raises `OperatorStopError` at the end of input, and without
    a terminal.
    """
    _require_terminal(question, "press keys")
    with announce_question(question):
        if question:
            print(question, file=sys.stderr, flush=True)
        before = termios.tcgetattr(sys.stdin)
        try:
            tty.setcbreak(sys.stdin, termios.TCSAFLUSH)
            key = os.read(sys.stdin.fileno(), 1).decode("ascii", "replace")
        finally:
            termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)
    if not key or key == "\x04":
        raise OperatorStopError("stopped: the terminal is gone; the arm holds its position")
    return "enter" if key in "\r\n" else key


def _terminal() -> bool:
    return sys.stdin.isatty() and sys.stderr.isatty()


def _require_terminal(question: str, what: str) -> None:
    if not _terminal():
        raise OperatorStopError(f"stopped: {question} [no terminal to {what} at]")


def _read_line(prompt: str) -> str:
    """Show a prompt with displays hidden; return the typed line in lower case with its line end.

    Input typed before the prompt is discarded. The end of input is "", a typed empty line is not.
    """
    with announce_question(prompt):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        print(prompt, end=" ", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().lower()
    _log.info("%s answered: %s", prompt, answer.strip() or ("Enter" if answer else "end of input"))
    return answer
