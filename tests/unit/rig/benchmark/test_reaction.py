"""`rig benchmark reaction`: what counts as caught, and one lift without and with a reaction."""

from dataclasses import replace

import pytest

from rig.benchmark import reaction as study
from rig.benchmark.harness import Report, Run
from rig.benchmark.reaction import ReactedLift, Reaction, ReactionOptions, measure
from rig.sessions.records import LiftOutcome
from support.benches import lighter, short_phases

CAUGHT = ReactedLift("t1", 1, LiftOutcome.CAUGHT, -2.0, (Reaction(0.01, 0.004, 6),), False, True, False)


@pytest.mark.parametrize(
    ("change", "caught"),
    [
        ({}, True),
        ({"turn_deg": 5.5}, False),
        ({"turn_deg": None}, False),
        ({"reactions": ()}, False),
        ({"outcome": LiftOutcome.FALLEN}, False),
        ({"outcome": LiftOutcome.SLIPPED}, False),  # not lifted fully, although friction could carry it
        ({"outcome": LiftOutcome.SLIPPED, "would_hold": False}, True),
    ],
)
def test_caught_is_a_small_turn_at_the_height_that_friction_allows(
    change: dict[str, object], caught: bool
) -> None:
    assert replace(CAUGHT, **change).caught is caught  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def report() -> Report:
    with short_phases(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "load_bench", lighter)
        return measure(ReactionOptions(objects=["t2"], lifts=1, wire_lifts=0), Run(jobs=1))


@pytest.mark.heavy
def test_reaction_catches_a_lift_that_slips_without(report: Report) -> None:
    everything, row = report.tables[0].records
    assert everything == row | {"object_id": "all"}
    counts = {"lifts": 1, "slipping": 1, "caught": 1, "cannot_hold": 0, "damaged": 0, "fallen": (0, 0)}
    assert row == row | counts
    assert row["turn_with_deg"] < 5.0 < row["turn_without_deg"]
    assert min(row["reactions"], row["counts_added"][1]) > 0
    [lift] = report.figures["lifts"]
    assert len(lift["with"]["reactions"]) == row["reactions"]
    assert not lift["without"]["reactions"]


@pytest.mark.heavy
def test_limits_without_lifts_that_hold_are_neither_kept_nor_missed(report: Report) -> None:
    met = {limit.name.split(",")[0]: limit.met for limit in report.limits}
    assert met["share of slipping lifts caught"] is True
    assert met["share of lifts with a reaction although the grip holds"] is None
