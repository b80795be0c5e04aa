"""Estimates that turn against the true angle, or at another time: named in row, table and page."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import DeviceError
from drivers.types import ArmState, Frame
from fakes.clock import SimulatedClock
from protocols.observer import LiftEvents, Phase
from rig.experiments.lift_plan import new_measurement, stored_trial
from rig.lift.agreement import clock_lag, find_turning_against
from rig.lift.measurement import LiftMeasurement
from rig.lift.recording import FrameDelays
from rig.lift.result import evaluate_lift
from rig.report.advice import trial_notices
from rig.report.session import read_trial
from rig.results.notes import lift_note
from rig.results.table import lifts_csv
from rig.sessions.reading import show_again
from rig.sessions.records import MOST_LAG_S, Lift
from rig.sessions.rows import read_finished_lifts
from rig.sessions.session import read_manifest
from rig.tactile.angles import Angles
from support.marks import heavy

TURN_DEG = 16.0


def angle_deg(time_s: np.ndarray, turn_deg: float = TURN_DEG) -> np.ndarray:
    """An object that begins to turn at 0.3 s and comes to rest at 1.1 s."""
    share = np.clip((time_s - 0.3) / 0.8, 0.0, 1.0)
    return turn_deg * share**2 * (3.0 - 2.0 * share)


def truth(late_s: float = 0.0, turn_deg: float = TURN_DEG) -> Angles:
    time_s = np.arange(-1.0, 2.7, 1 / 30)
    noise = np.random.default_rng(0).normal(0.0, 0.03, len(time_s))
    return Angles(time_s + 5.0 + late_s, angle_deg(time_s, turn_deg) + noise)


def answers(factor: float = 1.0, seed: int = 1, turn_deg: float = TURN_DEG) -> Angles:
    time_s = np.arange(0.0, 2.7, 1 / 60)
    drift = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.03, len(time_s)))
    angles = factor * angle_deg(time_s, turn_deg) + drift
    return Angles(time_s + 5.0, angles)


WITHOUT_ANGLES = replace(answers(), angle_deg=np.full(162, np.nan))


@pytest.mark.parametrize(
    ("tips", "said"),
    [
        (
            {"D1": answers(-0.95), "D2": answers(-1.0, 2)},
            "the fingertips may be exchanged: the estimate turned -1",
        ),
        ({"D1": answers(), "D2": answers(-1.0, 2)}, "the sign of D2 may be wrong"),
        ({"D1": answers(), "D2": answers(0.7)}, None),
        ({"D1": answers(0.0), "D2": answers(-0.2)}, None),
        ({"D1": WITHOUT_ANGLES, "D2": answers(-1.0).between(0, to_ns(5.15))}, None),
    ],
    ids=["exchanged", "one sign", "right", "resting", "without angles"],
)
def test_fingertips_that_turn_against_the_truth_are_named(tips: dict[str, Angles], said: str | None) -> None:
    found = find_turning_against(tips, truth())
    assert (found is None) == (said is None)
    if said is not None:
        assert str(found).startswith(said)
        assert "the markers +16" in str(found)
        assert found.exchanged == ("exchanged" in said)  # type: ignore[union-attr]


def test_object_that_hardly_turns_shows_neither_sign_nor_lag() -> None:
    assert find_turning_against({"D1": answers(-1.0, turn_deg=3.0)}, truth(turn_deg=3.0)) is None
    assert clock_lag(answers(turn_deg=3.0), truth(0.2, 3.0)) is None


@pytest.mark.parametrize("late_s", [-0.3, -0.1, 0.1, 0.3])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_lag_beyond_the_limit_is_measured(late_s: float, factor: float) -> None:
    found = clock_lag(answers(factor), truth(late_s))
    assert found is not None
    assert found.lag_s == pytest.approx(-late_s, abs=max(3 * found.sigma_s, 0.01))
    assert f"turns {abs(late_s):.1f}" in str(found)
    assert ("before" if late_s > 0 else "after") in str(found)


@pytest.mark.parametrize("seed", range(5))
def test_small_lag_is_not_a_warning(seed: int) -> None:
    for late_s in (0.0, 0.03, -0.03):
        assert abs(late_s) < MOST_LAG_S
        found = clock_lag(answers(seed=seed), truth(late_s))
        assert found is not None
        assert found.lag_s == pytest.approx(-late_s, abs=0.01)
        assert not found.large


class Changed(LiftEvents):
    """Passes a recorded lift on to a measurement, with other times of some frames."""

    def __init__(self, to: LiftMeasurement, time_of: Callable[[Frame], int]) -> None:
        self._to, self._time_of = to, time_of

    def phase(self, phase: Phase, time_ns: int) -> None:
        self._to.phase(phase, time_ns)

    def arm(self, state: ArmState) -> None:
        self._to.arm(state)

    def frame(self, frame: Frame) -> None:
        self._to.frame(replace(frame, time_ns=self._time_of(frame)))


def measured(
    session: Path,
    time_of: Callable[[Frame], int] = lambda frame: frame.time_ns,
    flipped: tuple[int, ...] = (),
) -> Lift:
    """The stored row of a session's lift, measured with other times and signs of these fingertips."""
    (row,) = read_finished_lifts(session)
    measurement = new_measurement(stored_trial(session).settings)
    for number, tip in enumerate(measurement.angle.tips.values()):
        tip.sign = -tip.sign if number in flipped else tip.sign
    phases_ns = {name: round(time_s * NS_PER_S) for name, time_s in row.phases_s.items()}
    show_again(session / row.recording, Changed(measurement, time_of), phases_ns)
    return evaluate_lift(measurement, row)


def notices_of(session: Path, row: Lift, warning: str) -> list[str]:
    """Fail unless a lift's note and table have a warning; return the notices of its page, worst first."""
    assert warning in lift_note(row)
    assert warning.encode() in lifts_csv([row])
    trial = read_trial(session, read_manifest(session))
    found = trial_notices(replace(trial, lifts=[row]))
    assert found[0].level == "bad"
    return [notice.what for notice in found]


@pytest.mark.heavy
def test_normal_lift_has_a_small_lag_and_no_warning(one_lift: Path) -> None:
    row = measured(one_lift)
    assert row.lag is not None
    assert row.warnings == ()
    assert lifts_csv([row]).decode().endswith(f",{row.lag.lag_s}\n")


@pytest.mark.heavy
def test_sigma_of_a_lift_is_that_of_its_estimate_during_phase_b(one_lift: Path) -> None:
    row = measured(one_lift)
    sigmas = sorted(row.estimate.sigma_deg[row.within("B") & np.isfinite(row.estimate.sigma_deg)])
    assert row.sigma_b_p95_deg is not None
    assert sigmas[int(0.9 * len(sigmas))] <= row.sigma_b_p95_deg <= sigmas[-1]
    assert f",{row.sigma_b_p95_deg}," in lifts_csv([row]).decode()


@pytest.mark.heavy
def test_lift_with_exchanged_fingertips_is_named_in_row_note_table_and_page(one_lift: Path) -> None:
    row = measured(one_lift, flipped=(0, 1))
    assert row.turns_against is not None
    assert row.re is not None
    assert row.re.mean_deg > 5.0
    found = notices_of(one_lift, row, "the fingertips may be exchanged")
    assert "turns against the markers" in found[0]


@pytest.mark.heavy
@pytest.mark.parametrize(("camera", "late_s"), [(True, -0.15), *heavy((True, 0.2), (False, 0.2))])
def test_lift_with_late_frames_is_named_in_row_note_table_and_page(
    one_lift: Path, camera: bool, late_s: float
) -> None:
    row = measured(one_lift, lambda f: f.time_ns + (to_ns(late_s) if ("C0001" in f.serial) == camera else 0))
    assert row.lag is not None
    assert row.lag.large
    assert row.lag.lag_s == pytest.approx(-late_s if camera else late_s, abs=0.03)
    found = notices_of(one_lift, row, "the markers (clocks of camera and fingertips)")
    assert any("do not turn at the same time" in what for what in found)


def rates(speed: dict[str, float], load: float = 0.0, jitter_s: float = 0.02) -> dict[str, float]:
    """The rates of three sources over 6 s. load: growth of the delay of all frames."""
    clock, rng = SimulatedClock(), np.random.default_rng(0)
    probe = FrameDelays(clock)
    image = np.zeros((8, 8, 3), np.uint8)
    for number in range(180):
        at_s = number / 30
        clock.sleep_until(to_ns(10.0 + at_s * (1.0 + load) + rng.uniform(0.0, jitter_s)))
        for serial in ("D1", "D2", "C"):
            probe.frame(Frame(image, to_ns(10.0 + at_s * speed.get(serial, 1.0)), number, serial))
    if found := probe.clock_rates():
        with pytest.raises(DeviceError, match="overloaded"):
            probe.check_clocks()
    return found


@pytest.mark.parametrize("speed", [0.7, 0.9, 1.1, 1.4])
def test_source_whose_stamps_run_at_another_speed_is_named(speed: float) -> None:
    assert rates({"C": speed}) == {"C": pytest.approx(speed, abs=0.02)}


def test_stamps_of_a_loaded_computer_are_not_named() -> None:
    assert rates({}) == {}
    assert rates({}, load=0.1) == {}
    assert rates({"C": 0.7}, load=0.1) == {"C": pytest.approx(0.73, abs=0.03)}
