"""Tests in real time run with a higher priority than other programs, if the user may set it.

If a test fails while other programs used the cores, it is skipped and named at the end.
"""

import json
import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import nullcontext
from pathlib import Path

import pytest

from drivers.errors import CalibrationError, DeviceError
from drivers.realtime import before_others
from support.waking import MOST_OTHERS_CORES

MOST_LATE_S = 0.05
"""Wake-up delay above which a host cannot meet the deadlines of an arm and of 60 frames per second."""
LATENESS = (DeviceError, AssertionError, pytest.fail.Exception, OSError, subprocess.SubprocessError)
"""What a loaded host can cause: a device that was not heard, a count that falls short. A replay that differs
is none of these (`recordings.ReplayDiffersError`)."""
REASON = "real time needs a computer with time"
WAKING = Path(__file__).with_name("waking.py")
_watch: pytest.StashKey["subprocess.Popen[str]"] = pytest.StashKey()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Connect in time, or skip."""
    if item.get_closest_marker("real_time") is not None:
        # a worker's tests are the whole run's: what its sisters compute is no business of others
        root = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()
        command = [sys.executable, "-I", "-S", str(WAKING), str(root)]
        with before_others():  # as the test: what keeps it waiting keeps the test waiting
            item.stash[_watch] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
    return (yield from _in_time(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Run in time, or skip."""
    return (yield from _in_time(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None]:
    """Let go in time, or skip."""
    try:
        return (yield from _in_time(item))
    finally:
        if (watch := item.stash.get(_watch, None)) is not None:
            watch.kill()
            watch.communicate()


def _in_time(item: pytest.Item) -> Generator[None]:
    """Run a test marked `real_time`; if it fails on a loaded host, skip it."""
    watch = item.stash.get(_watch, None)
    try:
        with nullcontext() if watch is None else before_others():
            return (yield)
    except LATENESS as failure:
        if watch is None or watch.poll() is not None:
            raise
        excuse = excuse_for(failure, **json.loads(watch.communicate(timeout=30)[0]))
        if excuse is None:
            raise
        pytest.skip(excuse)


def excuse_for(failure: BaseException, late_s: float, others_cores: float) -> str | None:
    """Return the host load that explains a failure; None if the host was not loaded.

    late_s, others_cores: as `support.waking` saw them. What no lack of time explains, as a
    calibration refused, has no excuse.
    """
    busy = late_s > MOST_LATE_S or others_cores > MOST_OTHERS_CORES
    if not busy or CalibrationError.__name__ in str(failure):
        return None
    said = str(failure).partition("\n")[0]
    return (
        f"{REASON}: this one stood still for {late_s:.2f} s, and other programs took {others_cores:.1f} "
        f"cores ({said})"
    )


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None]:
    """Print at the end the names of tests that were skipped because of host load."""
    yield
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or "PYTEST_XDIST_WORKER" in os.environ or session.config.option.collectonly:
        return
    late = [report.nodeid for report in reporter.stats.get("skipped", ()) if REASON in str(report.longrepr)]
    names = f"{len(late)}: {', '.join(late)}" if late else "none"
    reporter.write_line(f"tests in real time skipped because the computer was busy: {names}")
