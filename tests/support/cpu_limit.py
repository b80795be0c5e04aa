"""A limit of the CPU time that a test of a plain run may take, so that the plain run stays short."""

import os
import time
from collections.abc import Generator

import pytest

from end_to_end import is_end_to_end

LIMIT_S = 2.0
"""CPU time of a test and its child processes on the reference computer, s."""
REFERENCE_S = 0.0062
"""CPU time of `_work` on the reference computer: an Intel Xeon of 2.1 GHz (Sapphire Rapids), Python 3.11."""
SHARED_S, BEGAN_S = pytest.StashKey[float](), pytest.StashKey[float]()
"""CPU time of shared fixtures so far, and the CPU time without them at which a test began."""


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


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    item.stash[BEGAN_S] = _cpu_s() - item.config.stash[SHARED_S]
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, object, object]:
    """Fail a test that takes too long, unless all tests run, or it is end-to-end."""
    result = yield
    took_s = _cpu_s() - item.config.stash[SHARED_S] - item.stash[BEGAN_S]
    listed = item.config.getoption("--all") or is_end_to_end(item)
    if took_s > LIMIT_S and not listed and took_s > LIMIT_S * _slowness():
        pytest.fail(
            f"took {took_s:.1f} s of CPU time: make it cheaper, mark it 'heavy', or list it in end_to_end.py",
            pytrace=False,
        )
    return result


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
