"""Distribution of tests over workers: one file at a time per worker, real-time tests one after the other.

Real-time tests come first, on one worker. Those that mostly wait, `real_time(beside=True)`, run on a second
worker at the same time. The others have a lower priority until these are over (`give_way`); the folders with
the slowest files come first. Hardware is driven by one process: with `--bench` there are no workers.

There is one worker more than there are cores: while one waits for a device's deadline or a person's answer,
another computes.
"""

import os
import time
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.realtime import before_others

MOST_WORKERS = 4
"""Each takes 0.5 GB, and the tests in real time take longer than a quarter of the rest."""
REAL_TIME, BESIDE = "real_time", "beside real_time"
REAL_TIME_CORES = 2
"""Simulated devices and their drivers take more than one core, and fall behind if they get less."""
OWN_NICE, NICER = os.getpriority(os.PRIO_PROCESS, 0), 9
"""Niceness of this worker, and its increase during real-time tests. A page adds 10, and the limit is 19."""
POLL_S = 0.05
LONGEST_FIRST = ("tests/scenario", "tests/cli", "tests/unit/rig/benchmark")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One worker more than there are cores; none with hardware or if files are named on the command line."""
    named = any(".py" in argument for argument in config.args)
    alone = named or config.getoption("--bench") or _cores() == 1
    return 0 if alone else min(_cores() + 1, MOST_WORKERS)


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--bench") and config.getoption("tx"):
        raise pytest.UsageError("--bench: two workers must not drive one arm: leave -n, --dist and --tx out")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep files together, as they share what they make; real time first, then what takes longest."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(_real_time(item) or _file(item)))
    groups = list(dict.fromkeys(map(_group, items)))
    items.sort(key=lambda item: (_rank(item), groups.index(_group(item))))


def pytest_xdist_node_collection_finished(ids: list[str]) -> None:
    """Refuse to run where single tests would be dealt out: those in real time would disturb each other."""
    if not all(_without_group(name) != name for name in ids):
        raise pytest.UsageError("this pytest keeps no groups on one worker: install requirements.lock")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Report a test under the name it can be asked for by, without the group that the workers add."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        report.nodeid = _without_group(report.nodeid)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, object, object]:
    """Give way to tests in real time while there are any."""
    alone = "PYTEST_XDIST_WORKER" not in os.environ
    if alone or not any(_group(other) == REAL_TIME for other in item.session.items):
        return (yield)
    # each worker has a separate folder beside those of the others
    over = Path(str(item.config.getoption("basetemp"))).parent / "real_time_is_over"
    if _group(item) not in (REAL_TIME, BESIDE):
        give_way(over)
    try:
        return (yield)
    finally:
        if _group(item) == REAL_TIME and (nextitem is None or _group(nextitem) != REAL_TIME):
            over.touch()


def give_way(over: Path) -> None:
    """Let tests in real time come first: by priority, or by waiting if no core is left and none is granted.

    over: the file that is there once they are over.
    """
    while not (over.exists() or _cores() > REAL_TIME_CORES or real_time_is_granted()):
        time.sleep(POLL_S)
    with suppress(OSError):  # not every user may go back to a higher priority
        os.setpriority(os.PRIO_PROCESS, 0, OWN_NICE + (0 if over.exists() else NICER))


def real_time_is_granted() -> bool:
    """Whether tests in real time run before every other program, as root's do."""
    with before_others():
        return hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) == os.SCHED_RR


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _without_group(name: str) -> str:
    test, at, group = name.rpartition("@")
    return test if at and "]" not in group else name


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def _group(item: pytest.Item) -> str:
    marker = item.get_closest_marker("xdist_group")
    return str(marker.args[0]) if marker else ""


def _real_time(item: pytest.Item) -> str | None:
    """The group of a test in real time; None of another."""
    marker = item.get_closest_marker(REAL_TIME)
    if marker is None:
        return None
    return BESIDE if marker.kwargs.get("beside") else REAL_TIME


def _rank(item: pytest.Item) -> int:
    if _real_time(item):
        return 0
    long = (rank for rank, folder in enumerate(LONGEST_FIRST, 1) if item.nodeid.startswith(folder))
    return next(long, len(LONGEST_FIRST) + 1)
