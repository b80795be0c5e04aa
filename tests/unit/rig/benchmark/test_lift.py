"""`rig benchmark lift`: the account of the work of a lift, and the meter that adds it up."""

import sys
import time
from types import ModuleType

import pytest

from rig.benchmark import lift as study
from rig.benchmark.harness import Run
from rig.benchmark.lift import PARTS, REST, LiftOptions, measure, metered
from rig.tactile.slip.estimator import SlipEstimator
from support.benches import lighter

NAMES = {name: f"measured_work.{name}" for name in ("inner", "outer", "fails")}


def spend(cpu_s: float) -> None:
    end_s = time.thread_time() + cpu_s
    while time.thread_time() < end_s:
        pass


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A module of three functions: `outer` calls `inner` twice."""
    module = ModuleType("measured_work")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    module.inner = lambda: spend(0.04)  # type: ignore[attr-defined]
    module.outer = lambda: (spend(0.01), module.inner(), module.inner())  # type: ignore[attr-defined]
    module.fails = lambda: 1 / 0  # type: ignore[attr-defined]
    return module


def test_part_does_not_include_the_parts_that_it_calls(work: ModuleType) -> None:
    with metered(NAMES) as (spent_s, calls):
        work.outer()
        spend(0.02)
    assert calls == {"outer": 1, "inner": 2}
    assert spent_s["inner"] == pytest.approx(0.08, abs=0.01)
    assert spent_s["outer"] == pytest.approx(0.01, abs=0.008)
    assert spent_s[REST] == pytest.approx(0.02, abs=0.01)


def test_failed_call_is_counted_and_functions_are_restored(work: ModuleType) -> None:
    before = work.fails
    with metered(NAMES) as (_, calls), pytest.raises(ZeroDivisionError):
        work.fails()
    assert calls == {"fails": 1}
    assert work.fails is before


@pytest.mark.heavy
def test_account_has_every_part_of_a_lift(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "load_bench", lighter)
    before = SlipEstimator._estimate
    rows = {row.part: row for row in measure(LiftOptions(objects=["t1"]), Run()).tables[0].records}
    assert SlipEstimator._estimate is before
    assert set(rows) >= {*PARTS, REST} - {"simulated gel: set-up"}  # the set-up is cached
    assert sum(row.share for row in rows.values()) == pytest.approx(1.0)
    assert rows["slip: set-up"].calls == 2
    assert all(row.calls >= 1 for part, row in rows.items() if part != REST)
