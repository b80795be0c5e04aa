"""Distribution of tests over workers: one file at a time per worker, the slowest folders first.

Hardware is driven by one process: with `--bench` there are no workers. There are two workers more than there
are cores: while some wait for devices in slow motion or a person's answer, others compute.
"""

import os

import pytest

MOST_WORKERS = 4
"""Each takes 0.5 GB."""
WAITING_WORKERS = 2
LONGEST_FIRST = (
    "tests/scenario/test_wire.py", "tests/contract/test_devices_contract.py", "tests/scenario", "tests/cli",
    "tests/unit/rig/benchmark",
)  # fmt: skip
"""The first two wait two minutes each for devices in slow motion."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two workers more than there are cores; none with hardware or if files are named on the command line."""
    named = any(".py" in argument for argument in config.args)
    alone = named or config.getoption("--bench") or _cores() == 1
    return 0 if alone else min(_cores() + WAITING_WORKERS, MOST_WORKERS)


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--bench") and config.getoption("tx"):
        raise pytest.UsageError("--bench: two workers must not drive one arm: leave -n, --dist and --tx out")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep files together, as they share what they make; those that take longest come first."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(_file(item)))
    groups = list(dict.fromkeys(map(_group, items)))
    items.sort(key=lambda item: (_rank(item), groups.index(_group(item))))


def pytest_xdist_node_collection_finished(ids: list[str]) -> None:
    """Refuse to run if single tests would be dealt out: the tests of a file share what they make."""
    if not all(_without_group(name) != name for name in ids):
        raise pytest.UsageError("this pytest keeps no groups on one worker: install requirements.lock")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Report a test under the name it can be asked for by, without the group that the workers add."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        report.nodeid = _without_group(report.nodeid)


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


def _rank(item: pytest.Item) -> int:
    long = (rank for rank, folder in enumerate(LONGEST_FIRST) if item.nodeid.startswith(folder))
    return next(long, len(LONGEST_FIRST))
