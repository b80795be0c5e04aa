"""What all commands share: options, exit codes, stopping, and where output goes."""

import json
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from enum import IntEnum

from drivers.errors import InputError, OperatorStopError, RigError, SessionError
from rig.live.output import discard


class Exit(IntEnum):
    """Exit codes (contract, commands)."""

    DONE = 0
    FAULT = 1
    USAGE = 2
    STOPPED = 3
    LIMIT_MISSED = 4


def say(text: str) -> None:
    """Print a line for people: on stderr, so that stdout stays for results."""
    print(text, file=sys.stderr, flush=True)


_answered = False


def emit_json(value: Mapping[str, object]) -> None:
    """Print the one JSON object of a command."""
    global _answered
    _answered = True
    print(json.dumps(value))


def print_result(json: bool, values: Mapping[str, object], *lines: object) -> None:
    """Print the result of a command: one JSON object of the values if `json` is True, else the lines."""
    if json:
        emit_json(values)
    else:
        for line in lines:
            print(line)


def mark(simulated: bool) -> str:
    """Return the mark of simulated results, to print in front of them; "" for those of a real bench."""
    return "SIMULATED " if simulated else ""


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


def trial_jobs(asked: int | None, in_process: bool, realtime: bool) -> int:
    """Return how many lifts run side by side: by default one per core where benches are simulated.

    Raises `InputError` for several at one bench.
    """
    if not in_process and (asked or 1) > 1:
        raise InputError(f"--jobs {asked}: there is one bench, which does one lift at a time; leave it out")
    return asked or (1 if realtime or not in_process else max(1, os.cpu_count() or 1))
