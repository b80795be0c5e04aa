"""What all commands share: options, exit codes, stopping, and where output goes."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import IntEnum
from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import InputError, OperatorStopError, RigError, SessionError
from rig.cli.output import discard
from rig.live.onlookers import asked


class Exit(IntEnum):
    """Exit codes (contract, commands)."""

    DONE = 0
    FAULT = 1
    USAGE = 2
    STOPPED = 3
    LIMIT_MISSED = 4


JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything simulated or drawn.")]
JobsOption = Annotated[
    int | None, typer.Option("--jobs", min=1, max=64, help="Lifts side by side; default: cores.")
]
BenchOption = Annotated[str, typer.Option("--bench", help="fake, hard, wire, or the path of a bench file.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Agree to every question (for scripts).")]
ObjectsOption = Annotated[
    Path | None,
    typer.Option("--objects", help="Folder of your own objects; default: objects/ beside the bench file."),
]
TopicOption = Annotated[
    str | None,
    typer.Option(
        "--topic", help="Of a ROS bag: the topic of the images. Default: the only topic of images in it."
    ),
]
NameOption = Annotated[str | None, typer.Option("--name", help="What the session is called, in one line.")]
NoteOption = Annotated[str | None, typer.Option("--note", help="A line kept with the session.")]
TagOption = Annotated[
    list[str] | None, typer.Option("--tag", help="A word to find the session by; repeat for more.")
]
OperatorOption = Annotated[str | None, typer.Option("--operator", help="Who stands at the bench.")]
OutOption = Annotated[
    Path | None, typer.Option("--out", help="Session folder; default sessions/<date>_<what>.")
]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Continue the session in --out.")]
ResumeStoredOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue the session in --out, or the newest unfinished one on this bench, with its options.",
    ),
]


def say(text: str) -> None:
    """Print a line for people: on stderr, so that stdout stays for results."""
    print(text, file=sys.stderr, flush=True)


_answered = False


def emit_json(value: Mapping[str, object]) -> None:
    """Print the one JSON object of a command."""
    global _answered
    _answered = True
    print(json.dumps(value))


def begin_answer() -> None:
    """Begin a command, which has printed no JSON object yet."""
    global _answered
    _answered = False


def emit_error(message: str, kind: str, code: int) -> None:
    """Print what ended a command that was asked for JSON, unless it has printed its object already."""
    if "--json" in sys.argv and not _answered:
        with suppress(OSError, ValueError):
            emit_json({"error": {"kind": kind, "message": message, "exit_code": code}})


def exit_code(error: RigError) -> Exit:
    """Return the exit code of an error."""
    if isinstance(error, OperatorStopError):
        return Exit.STOPPED
    return Exit.USAGE if isinstance(error, InputError) else Exit.FAULT


def report_broken(problems: Sequence[str]) -> None:
    """End as with any input that cannot be used, once everything else is done.

    problems: what was left out. Raises `SessionError` where there are any.
    """
    for problem in problems[:-1]:
        say(f"left out: {problem}")
    if problems:
        raise SessionError(f"done, except for what is broken: {problems[-1]}")


STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)
"""Signals that always end a command; SIGHUP does, unless the command was told to outlive its terminal."""


def stop_on_signals() -> None:
    """Make Ctrl-C, SIGQUIT, a polite kill and a lost terminal end in the same safe teardown as an error.

    The first one raises `OperatorStopError` where the program is. The second one raises it once more,
    in the teardown, which then stops all motion and leaves everything where it is; further ones are
    ignored, because nothing may come between a stop and the hardware. A program that was told to
    outlive its terminal (nohup) does.
    """
    received = 0
    terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]

    def stop(number: int, _: object) -> None:
        nonlocal received
        received += 1
        if number == signal.SIGHUP:
            discard(terminals)
        if received == 1:
            _say_if_heard("stopping: the bench is being made safe; Ctrl-C again stops all motion at once ...")
            raise OperatorStopError("stopped by the operator; what was finished is kept")
        if received == 2:
            _say_if_heard("stopping all motion at once ...")
            raise OperatorStopError("all motion stopped at once by the operator")

    for number in STOPS:
        signal.signal(number, stop)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, stop)


def _say_if_heard(text: str) -> None:
    with suppress(OSError, ValueError):  # nobody reads any more: what follows matters more
        say(text)


def session_folder(out: Path | None, resume: bool, kind: str, object_id: str | None = None) -> Path:
    """Return where a session goes. Raises `InputError` for --resume without saying what to resume."""
    from rig.sessions.session import default_folder

    if resume and out is None:
        raise InputError("--resume continues the session in --out: give its folder")
    return out or default_folder(kind, object_id)


def trial_jobs(asked: int | None, in_process: bool, realtime: bool) -> int:
    """Return how many lifts run side by side: by default one per core where benches are simulated.

    Raises `InputError` for several at one bench.
    """
    if not in_process and (asked or 1) > 1:
        raise InputError(f"--jobs {asked}: there is one bench, which does one lift at a time; leave it out")
    return asked or (1 if realtime or not in_process else max(1, os.cpu_count() or 1))


def ask(question: str) -> bool:
    """Ask the person at the terminal; no terminal to ask and answer at means no."""
    if not _terminal():
        say(f"{question} [no terminal to ask and answer at: no; use --yes to agree beforehand]")
        return False
    while (answer := _typed(f"{question} [y/N]:")) not in ("", "n", "no", "y", "yes"):
        say(f"'{answer}' is neither y nor n")
    return answer in ("y", "yes")


def tell(question: str) -> str:
    """Ask the person at the terminal for a line. Raises `OperatorStopError` without a terminal."""
    if not _terminal():
        raise OperatorStopError(f"stopped: {question} [no terminal to ask and answer at]")
    return _typed(question)


@contextmanager
def waited(question: str) -> Iterator[Callable[[], bool]]:
    """Put a question while something else goes on; what is given says whether it was answered by Enter.

    Raises `OperatorStopError` for "q", for a terminal that is gone, and without one.
    """
    import select
    import termios

    if not _terminal():
        raise OperatorStopError(f"stopped: {question} [no terminal to ask and answer at]")

    def answered() -> bool:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return False
        line = sys.stdin.readline()
        if not line or line.strip().lower() in ("q", "quit", "stop"):
            raise OperatorStopError("stopped by the operator; the arm is held where it is")
        return True

    with asked(question):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        print(question, file=sys.stderr, flush=True)
        yield answered


def press(question: str) -> str:
    """Return the next key that is pressed from now on, "enter" for Enter; keys pressed before are none.

    question: put first, where it is not empty. Raises `OperatorStopError` at the end of input, and without
    a terminal.
    """
    import termios
    import tty

    if not _terminal():
        raise OperatorStopError(f"stopped: {question} [no terminal to press keys at]")
    with asked(question):
        if question:
            say(question)
        before = termios.tcgetattr(sys.stdin)
        try:
            tty.setcbreak(sys.stdin, termios.TCSAFLUSH)
            key = os.read(sys.stdin.fileno(), 1).decode("ascii", "replace")
        finally:
            termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)
    if not key or key == "\x04":
        raise OperatorStopError("stopped: the terminal is gone; the arm stands where it is")
    return "enter" if key in "\r\n" else key


def _terminal() -> bool:
    """Whether a question is seen, and answered by who sees it."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _typed(prompt: str) -> str:
    """Show a prompt, alone on the terminal; return the line typed since, in lower case, "" at its end.

    What was typed before answers another question, or none.
    """
    import termios

    with asked(prompt):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        print(prompt, end=" ", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower()
