"""Run the command line in this process, as `python -m rig` runs it in a separate one."""

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any

import pytest

from rig.cli.common import STOPS
from rig.cli.main import main
from support.slow_motion import IN_SLOW_MOTION

SHORT_PHASES = f"""{IN_SLOW_MOTION}
import protocols.slip_trial as trial
trial.GRASP_S, trial.HOLD_S = 1.5, 0.5
from rig.cli.main import main
main()
"""
"""For `python -c`: `rig` in slow motion, with less time before and after a lift, in which nothing happens."""


def rig(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run `rig ARGUMENTS` away from a terminal; return its exit code and what it printed.

    An error that the command line does not turn into a line and an exit code is raised here; in a separate
    process it would end in a traceback.
    """
    command = ["rig", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    with _away_from_a_terminal(command), _signals_kept(), redirect_stdout(out), redirect_stderr(err):
        code = _exit_code()
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


def succeed(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run `rig ARGUMENTS` as `rig` does; fail unless its exit code is 0."""
    done = rig(*arguments)
    assert done.returncode == 0, done.stderr
    return done


def answer(*arguments: object) -> Any:
    """Return the object that `rig ARGUMENTS --json` prints; fail unless its exit code is 0."""
    return json.loads(succeed(*arguments, "--json").stdout)


def refusal(*arguments: object) -> str:
    """Return the messages of `rig ARGUMENTS`; fail unless it is refused, with exit code 2."""
    done = rig(*arguments)
    assert done.returncode == 2, done.stderr
    return done.stderr


def refusal_line(*arguments: object) -> str:
    """Return the line that explains why `rig ARGUMENTS` is refused."""
    last = refusal(*arguments).splitlines()[-1]
    assert last.startswith("rig: ")
    return last


def _exit_code() -> int:
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


@contextmanager
def _away_from_a_terminal(command: list[str]) -> Iterator[None]:
    with open(os.devnull) as nothing, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", command)
        patch.setattr(sys, "stdin", nothing)
        yield


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Restore the signal handlers that the command line replaces."""
    before = {number: signal.getsignal(number) for number in (*STOPS, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
