"""Which tests run side by side: a file at a time on each core, tests in real time one after the other.

Real time comes first, on one worker, and has two cores to itself: simulated devices and their drivers
take more than one, and fall behind where they get less. Tests in real time that mostly wait,
`real_time(beside=True)`, run beside the others in real time, on a second worker. Then come the folders
whose files take longest. Hardware is driven by one process: with `--bench` there are no workers.

There is a worker more than there are cores: where one waits, for a device's deadline or a person's answer,
another computes.
"""

import fcntl
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import pytest

MOST_WORKERS = 4
"""Each takes 0.5 GB, and the tests in real time take longer than a quarter of the rest."""
REAL_TIME, BESIDE = "real_time", "beside real_time"
REAL_TIME_CORES, POLL_S = 2, 0.05
LONGEST_FIRST = ("tests/scenario", "tests/cli", "tests/unit/rig/benchmark")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One more than there are cores; none at hardware, nor for files that somebody names, to see them run."""
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
    """Leave two cores to tests in real time while there are any."""
    alone = "PYTEST_XDIST_WORKER" not in os.environ
    if alone or not any(_group(other) == REAL_TIME for other in item.session.items):
        return (yield)
    # Of a worker this is a folder of its own, beside those of the others.
    over = Path(str(item.config.getoption("basetemp"))).parent / "real_time_is_over"
    if _group(item) == BESIDE:
        return (yield)
    if _group(item) != REAL_TIME:
        with _core(over):
            return (yield)
    try:
        return (yield)
    finally:
        if nextitem is None or _group(nextitem) != REAL_TIME:
            over.touch()


@contextmanager
def _core(over: Path) -> Generator[None]:
    """Wait for one of the cores that tests in real time leave; there is no need to once they are over."""
    core: TextIO | None = None
    while core is None and not over.exists():
        core = _free_core(over)
        time.sleep(0.0 if core else POLL_S)
    try:
        yield
    finally:
        if core is not None:
            core.close()


def _free_core(over: Path) -> TextIO | None:
    for core in range(REAL_TIME_CORES, _cores()):
        file = over.with_name(f"{over.name}-{core}").open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
        else:
            return file
    return None


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
