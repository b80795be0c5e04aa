"""Which tests run side by side: a file at a time on each core, tests in real time one after the other.

Real time comes first, on one worker, and has the computer to itself: simulated devices and their drivers
take more than a core, and fall behind beside others. Then come the folders whose files take longest.
Hardware is driven by one process: with `--bench` there are no workers.

There is a worker more than there are cores: where one waits, for a device's deadline or a person's answer,
another computes.
"""

import fcntl
import os
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import TextIO

import pytest

MOST_WORKERS = 4
"""Each takes 0.5 GB, and the tests in real time take longer than a quarter of the rest."""
REAL_TIME = "real_time"
_room: list[TextIO] = []
"""What keeps the other workers out while this one is between two tests in real time."""
LONGEST_FIRST = ("tests/scenario", "tests/cli", "tests/unit/rig/benchmark")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One more than there are cores; none at hardware, nor for files that somebody names, to see them run."""
    named = any(".py" in argument for argument in config.args)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return 0 if named or config.getoption("--bench") or cores == 1 else min(cores + 1, MOST_WORKERS)


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--bench") and config.getoption("tx"):
        raise pytest.UsageError("--bench: two workers must not drive one arm: leave -n, --dist and --tx out")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep files together, as they share what they make; real time first, then what takes longest."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            real_time = item.get_closest_marker(REAL_TIME) is not None
            item.add_marker(pytest.mark.xdist_group(REAL_TIME if real_time else _file(item)))
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
    """Leave the computer to tests in real time while there are any."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if run is None:
        return (yield)
    real_time = _group(item) == REAL_TIME
    room = _room.pop() if _room else _entered(Path(tempfile.gettempdir()), run, real_time)
    try:
        return (yield)
    finally:
        if real_time and nextitem is not None and _group(nextitem) == REAL_TIME:
            _room.append(room)
        else:
            room.close()


def _entered(folder: Path, run: str, alone: bool) -> TextIO:
    """Wait for the computer; alone: until nobody else computes, and nobody new begins meanwhile."""
    with (folder / f"rig-tests-{run}-door").open("w") as door:
        fcntl.flock(door, fcntl.LOCK_EX)
        room = (folder / f"rig-tests-{run}-room").open("w")
        fcntl.flock(room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
    return room


def _without_group(name: str) -> str:
    test, at, group = name.rpartition("@")
    return test if at and "]" not in group else name


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def _group(item: pytest.Item) -> str:
    marker = item.get_closest_marker("xdist_group")
    return str(marker.args[0]) if marker else ""


def _rank(item: pytest.Item) -> int:
    if _group(item) == REAL_TIME:
        return 0
    long = (rank for rank, folder in enumerate(LONGEST_FIRST, 1) if item.nodeid.startswith(folder))
    return next(long, len(LONGEST_FIRST) + 1)
