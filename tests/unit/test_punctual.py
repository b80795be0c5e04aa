"""A process asks to be woken on time, and goes on where that is not allowed."""

import os

import pytest

from drivers.punctual import be_punctual


def test_the_lowest_real_time_priority_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, p: asked.append((pid, policy, p.sched_priority))
    )
    be_punctual()
    assert asked == [(0, os.SCHED_RR, os.sched_get_priority_min(os.SCHED_RR))]


def test_a_refusal_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    be_punctual()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
