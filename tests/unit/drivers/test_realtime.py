"""A process requests real-time priority, and continues without it if the request is refused."""

import gc
import os
import threading
from collections.abc import Iterator

import pytest

from drivers.realtime import ask_for_realtime, ordinary, realtime


class Asked:
    """Records the requests for each thread; nothing changes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.of: list[tuple[int, int, int]] = []
        monkeypatch.setattr(
            os,
            "sched_setscheduler",
            lambda thread, policy, p: self.of.append((thread, policy, p.sched_priority)),
        )

    def of_thread(self, thread: int) -> list[int]:
        return [policy for asked, policy, _ in self.of if asked == thread]


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


def test_lowest_real_time_priority_is_requested_for_all_threads(
    monkeypatch: pytest.MonkeyPatch, other: int
) -> None:
    asked = Asked(monkeypatch)
    ask_for_realtime()
    lowest = os.sched_get_priority_min(os.SCHED_RR)
    assert {(threading.get_native_id(), os.SCHED_RR, lowest), (other, os.SCHED_RR, lowest)} <= set(asked.of)


def test_refused_real_time_priority_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    before = os.sched_getscheduler(0)
    ask_for_realtime()
    assert os.sched_getscheduler(0) == before


def test_real_time_priority_ends_with_its_context(monkeypatch: pytest.MonkeyPatch, other: int) -> None:
    asked = Asked(monkeypatch)
    with realtime():
        assert gc.get_freeze_count() > 0
        over = threading.Event()
        begun_within = threading.Thread(target=over.wait)
        begun_within.start()
    over.set()
    begun_within.join()
    assert gc.get_freeze_count() == 0
    for thread in (threading.get_native_id(), other):
        assert asked.of_thread(thread) == [os.SCHED_RR, os.sched_getscheduler(0)]
    assert not asked.of_thread(begun_within.native_id or 0), "a device's thread keeps what it began with"


def test_busy_waiting_code_has_no_real_time_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, p: asked.append(policy))
    with ordinary():
        assert not asked, "this one has none to give up"
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_RR)
    with ordinary():
        assert asked == [os.SCHED_OTHER]
    assert asked == [os.SCHED_OTHER, os.SCHED_RR]
