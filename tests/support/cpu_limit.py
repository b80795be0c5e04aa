"""A limit of the CPU time that a test of a plain run may take, so that the plain run stays short."""

import os
import time
from collections.abc import Generator

import pytest
from _pytest.runner import runtestprotocol

from end_to_end import is_end_to_end, is_heavy

LIMIT_S = 2.0
"""CPU time of a test and its child processes on the reference computer, s."""
REFERENCE_S = 0.0062
"""CPU time of `_work` on the reference computer: an Intel Xeon of 2.1 GHz (Sapphire Rapids), Python 3.11."""
SHARED_S = pytest.StashKey[float]()
"""CPU time of shared fixtures so far."""


def pytest_configure(config: pytest.Config) -> None:
    config.stash[SHARED_S] = 0.0


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Add up the CPU time of fixtures that tests share: it is not that of the test that comes first."""
    stash, began, before = request.config.stash, _cpu_s(), request.config.stash[SHARED_S]
    result = yield
    if fixturedef.scope != "function":
        stash[SHARED_S] = before + _cpu_s() - began  # with the fixtures that this one has asked for
    return result


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Fail a test that takes too long twice, unless all tests run, or it is heavy or end-to-end.

    The first run in a process also makes everything that the process keeps: imports, tables and caches.
    """
    if item.config.getoption("--all") or is_end_to_end(item) or is_heavy(item):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports, took_s = _run(item, nextitem)
    if took_s > LIMIT_S and all(report.passed for report in reports):
        reports, took_s = _run(item, nextitem)
        if took_s > LIMIT_S * _slowness():
            cure = "make it cheaper, mark it 'heavy', or list it in end_to_end.py"
            reports[-1].outcome, reports[-1].longrepr = "failed", f"took {took_s:.1f} s of CPU time: {cure}"
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _run(item: pytest.Item, nextitem: pytest.Item | None) -> tuple[list[pytest.TestReport], float]:
    """Run a test without logging, and return its reports and its CPU time without shared fixtures, s."""
    began_s = _cpu_s() - item.config.stash[SHARED_S]
    reports = runtestprotocol(item, log=False, nextitem=nextitem)
    return reports, _cpu_s() - item.config.stash[SHARED_S] - began_s


def _cpu_s() -> float:
    """Return the CPU time of this process and of its child processes that have ended, s."""
    times = os.times()
    return sum(times[:4])


def _slowness() -> float:
    """Return how much slower than the reference computer this one is now: at least 1."""
    return max(1.0, min(_work_s() for _ in range(3)) / REFERENCE_S)


def _work_s() -> float:
    began = time.process_time()
    sum(number * number % 7 for number in range(100_000))
    return time.process_time() - began
