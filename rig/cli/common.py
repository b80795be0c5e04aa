"""Functions that all commands share: exit codes, signals, JSON output and messages."""

import json
import os
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from enum import IntEnum
from types import FrameType
from typing import TYPE_CHECKING

from drivers.errors import EstimatorError, InputError, OperatorStopError, SessionError
from rig.terminal.screen import discard

if TYPE_CHECKING:
    from rig.tactile.sample import EstimatorFaults


NO_BROWSER = "no browser could be started: open the address above in a browser on this computer"


class Exit(IntEnum):
    DONE = 0
    FAULT = 1
    USAGE = 2
    STOPPED = 3
    LIMIT_MISSED = 4


def say(text: str) -> None:
    """Print a message on stderr; stdout is for results only."""
    print(text, file=sys.stderr, flush=True)


_answered = False


def emit_json(value: Mapping[str, object]) -> None:
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
    """Return the prefix of printed results: "SIMULATED " for simulated ones, "" for those of a real bench."""
    return "SIMULATED " if simulated else ""


def begin_answer() -> None:
    """Note that the command that begins has not printed its JSON object yet."""
    global _answered
    _answered = False


def emit_error(message: str, kind: str, code: int) -> None:
    """Print an error as a JSON object if --json was given and the command has not printed its result yet."""
    if "--json" in sys.argv and not _answered:
        with suppress(OSError, ValueError):
            emit_json({"error": {"kind": kind, "message": message, "exit_code": code}})


def report_broken(problems: Sequence[str]) -> None:
    """Report the broken inputs that a command has left out, after it has processed all others.

    problems: a message per input that was left out. Raises `SessionError` if there are any.
    """
    for problem in problems[:-1]:
        say(f"left out: {problem}")
    if problems:
        raise SessionError(f"done, except for broken inputs: {problems[-1]}")


def report_faults(faults: "Iterable[EstimatorFaults]") -> None:
    """Report frames on which a user-defined estimator failed, after the results. Raises `EstimatorError`."""
    from rig.tactile.sample import together

    if found := list(faults):
        raise EstimatorError(f"done, but {together(found)}")


STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)
"""Signals that always end a command. SIGHUP ends it too, unless it was ignored at the start (nohup)."""


IMPORTED_S = 0.005
"""Time after which a signal that came during an import takes effect, s."""


def stop_on_signals() -> None:
    """Handle SIGINT (Ctrl-C), SIGQUIT, SIGTERM and SIGHUP by the same safe teardown as an error.

    The first signal raises `OperatorStopError` in the running code. The second one raises it again, in the
    teardown, which then stops all motion and leaves everything where it is. Further signals are ignored,
    so that they cannot interrupt the stop commands to the hardware. SIGHUP stays ignored if it was ignored
    at the start (nohup). A signal during Python's own import code takes effect a moment later: Python
    discards an exception raised there while the lock of a module is removed.
    """
    received = 0
    terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal received
        if frame is not None and frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.signal(signal.SIGALRM, lambda _, then: stop(number, then))
            signal.setitimer(signal.ITIMER_REAL, IMPORTED_S)
            return
        received += 1
        if number == signal.SIGHUP:
            discard(terminals)
        if received == 1:
            _say_if_possible("stopping safely; Ctrl-C again stops at once, all motion included ...")
            raise OperatorStopError("stopped by the operator; finished results are kept")
        if received == 2:
            _say_if_possible("stopping all motion at once ...")
            raise OperatorStopError("all motion stopped at once by the operator")

    for number in STOPS:
        signal.signal(number, stop)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, stop)


def _say_if_possible(text: str) -> None:
    with suppress(OSError, ValueError):  # stderr is closed: the stop goes on without the message
        say(text)


def trial_jobs(asked: int | None, in_process: bool, realtime: bool) -> int:
    """Return the number of lifts to run in parallel: by default one per core on benches simulated in-process.

    asked: value of --jobs. Raises `InputError` for more than one on any other bench.
    """
    if not in_process and (asked or 1) > 1:
        raise InputError(f"--jobs {asked}: this bench does one lift at a time; leave --jobs out")
    return asked or (1 if realtime or not in_process else max(1, os.cpu_count() or 1))
