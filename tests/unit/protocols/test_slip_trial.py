"""The times of a lift's phases that do not depend on the motion."""

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import NS_PER_S
from protocols.slip_trial import GRASP_S, SETTLE_S, LiftPlan, run_lift
from support.worlds import HOME


class LiftBegan(Exception):  # noqa: N818 - no error
    """The lift has reached its next phase."""


@pytest.mark.parametrize(("closing_s", "waits_s"), [(0.5, GRASP_S - 0.5), (GRASP_S + 1.0, SETTLE_S)])
def test_contact_settles_before_the_lift_however_long_the_closing_took(
    monkeypatch: pytest.MonkeyPatch, closing_s: float, waits_s: float
) -> None:
    waited: list[float] = []
    times_ns = iter([0, round(closing_s * NS_PER_S)])
    pump = SimpleNamespace(run_for=waited.append, seen_ns=0)

    def begin(*_: object) -> None:
        raise LiftBegan

    replacements: dict[str, Any] = {
        "check_way": lambda *_: None, "safe_end": nullcontext, "approach": lambda *_: None,
        "start_watching": lambda *_: pump, "close_to_contact": lambda *_: 0.03, "tighten": lambda *_: None,
        "Reflex": begin,
    }  # fmt: skip
    for name, replacement in replacements.items():
        monkeypatch.setattr(f"protocols.slip_trial.{name}", replacement)
    bench: Any = SimpleNamespace(
        arm=SimpleNamespace(limits=None), clock=SimpleNamespace(now_ns=lambda: next(times_ns))
    )
    observer: Any = SimpleNamespace()
    with pytest.raises(LiftBegan):
        run_lift(bench, LiftPlan("t1", "wrench", "left", HOME, 0.03, 4, 0.05), observer)
    assert waited == [pytest.approx(waits_s)]
