"""A process requests real-time priority, and continues without it if the request is refused."""

import gc
import os
import threading
from collections.abc import Iterator

import pytest

from drivers.realtime import ask_for_realtime, ordinary, realtime


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int, int]]:
    """Thread, policy and priority of each request; nothing changes."""
    asked: list[tuple[int, int, int]] = []

    def request(thread: int, policy: int, param: os.sched_param) -> None:
        asked.append((thread, policy, param.sched_priority))

    monkeypatch.setattr(os, "sched_setscheduler", request)
    return asked


def policies(asked: list[tuple[int, int, int]], thread: int) -> list[int]:
    return [policy for of, policy, _ in asked if of == thread]


@pytest.fixture
def other() -> Iterator[int]:
    """A waiting thread of this process."""
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    assert thread.native_id is not None
    yield thread.native_id
    over.set()
    thread.join()


@pytest.mark.heavy
def test_lowest_real_time_priority_is_requested_for_all_threads(
    asked: list[tuple[int, int, int]], other: int
) -> None:
    ask_for_realtime()
    lowest = os.sched_get_priority_min(os.SCHED_RR)
    assert {(threading.get_native_id(), os.SCHED_RR, lowest), (other, os.SCHED_RR, lowest)} <= set(asked)


def test_refused_real_time_priority_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    before = os.sched_getscheduler(0)
    ask_for_realtime()
    assert os.sched_getscheduler(0) == before


def test_real_time_priority_ends_with_its_context(asked: list[tuple[int, int, int]], other: int) -> None:
    with realtime():
        assert gc.get_freeze_count() > 0
        over = threading.Event()
        begun_within = threading.Thread(target=over.wait)
        begun_within.start()
    over.set()
    begun_within.join()
    assert gc.get_freeze_count() == 0
    for thread in (threading.get_native_id(), other):
        assert policies(asked, thread) == [os.SCHED_RR, os.sched_getscheduler(0)]
    assert not policies(asked, begun_within.native_id or 0), "a device's thread keeps what it began with"


def test_busy_waiting_code_has_no_real_time_priority(
    asked: list[tuple[int, int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    with ordinary():
        assert not asked, "this one has none to give up"
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_RR)
    with ordinary():
        assert policies(asked, 0) == [os.SCHED_OTHER]
    assert policies(asked, 0) == [os.SCHED_OTHER, os.SCHED_RR]
