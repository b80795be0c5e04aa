"""A process asks to be woken on time, and goes on where that is not allowed."""

import gc
import os

import pytest

from drivers.realtime import ask_for_realtime, ordinary, realtime


def test_the_lowest_real_time_priority_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, p: asked.append((pid, policy, p.sched_priority))
    )
    ask_for_realtime()
    assert asked == [(0, os.SCHED_RR, os.sched_get_priority_min(os.SCHED_RR))]


def test_a_refusal_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    ask_for_realtime()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_punctual_for_a_while_ends_as_it_began(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, p: asked.append(policy))
    with realtime():
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0
    assert asked == [os.SCHED_RR, os.SCHED_OTHER]


def test_what_computes_while_it_waits_has_no_real_time_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, p: asked.append(policy))
    with ordinary():
        assert not asked, "this one has none to give up"
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_RR)
    with ordinary():
        assert asked == [os.SCHED_OTHER]
    assert asked == [os.SCHED_OTHER, os.SCHED_RR]
