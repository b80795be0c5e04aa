"""Lifts without motions: a trial's order, questions, rows and files, without the computation of lifts."""

from collections.abc import Collection
from dataclasses import fields, replace
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from rig.lift.measurement import LiftMeasurement
from rig.sessions.records import Lift, LiftOutcome
from rig.sessions.rows import read_finished_lifts

STORED_TRIAL = Path(__file__).parents[1] / "data" / "stored_trial"


def quick_lifts(patch: pytest.MonkeyPatch, falling: Collection[str] = (), fault: str | None = None) -> None:
    """Leave out the motions of lifts, which end with the figures of the stored trial or with a fault.

    The bench is made ready and the object is placed as usual. falling: ids of the objects that fall.
    """
    (stored,) = read_finished_lifts(STORED_TRIAL)
    figures = {of.name: getattr(stored, of.name) for of in fields(Lift) if "figure" in of.metadata}

    def run(*_: object) -> None:
        if fault is not None:
            raise DeviceError(fault)

    def result(_: LiftMeasurement, lift: Lift) -> Lift:
        outcome = LiftOutcome.FALLEN if lift.object in falling else LiftOutcome.SLIPPED
        ended = {"bench_s": lift.bench_s, "accepted": True, "fault": None, "outcome": outcome}
        return replace(lift, **{**figures, **ended})

    patch.setattr("rig.experiments.lift_attempt.run_lift", run)
    patch.setattr("rig.experiments.lift_attempt.evaluate_lift", result)
