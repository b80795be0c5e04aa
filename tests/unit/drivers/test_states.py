"""Invalid values cannot become a state: NaN, infinity, wrong types, lengths and ranges are rejected."""

import math
from dataclasses import fields, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceError, InvalidStateError, OutOfLimitsError
from drivers.types import ArmMode, ArmState, GripperSpec, GripperState, HandState, Holding, Pose

AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ARM = ArmState(1, Pose((0.4, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0)), AT_REST, AT_REST, ArmMode.RUNNING, 1.0)
GRIPPER = GripperState(1, True, False, 0.05, 0, current_a=0.1, raw=MappingProxyType({"position_counts": 120}))
HAND = HandState(Holding.HELD, "wrench", ARM.base_T_tcp, 0.012, 0.05)

NOT_FINITE = st.sampled_from([math.nan, math.inf, -math.inf, np.float64("nan")])
NO_NUMBER = st.one_of(st.booleans(), st.text(max_size=3), st.just(np.float32(1.0)), st.just([1.0]))
INVALID_NUMBER = st.one_of(NOT_FINITE, NO_NUMBER, st.just(10**400))
INVALID_INTEGER = st.one_of(NOT_FINITE, NO_NUMBER, st.floats(), st.just(np.int64(3)))


@st.composite
def invalid_vectors(draw: st.DrawFn, length: int) -> Any:
    """Tuples of a wrong length or with an invalid number, and values of other types."""
    valid: list[Any] = draw(st.lists(st.floats(-1, 1), min_size=length, max_size=length))
    kind = draw(st.sampled_from(["number", "shorter", "longer", "list", "array", "other"]))
    if kind == "number":
        valid[draw(st.integers(0, length - 1))] = draw(st.one_of(st.none(), INVALID_NUMBER))
    elif kind == "list":
        return valid
    elif kind == "array":
        return np.array(valid)
    elif kind == "other":
        return draw(INVALID_NUMBER)
    return tuple({"shorter": valid[1:], "longer": [*valid, 0.0]}.get(kind, valid))


INVALID_POSE = st.one_of(
    st.just("home"),
    invalid_vectors(3).map(lambda position: Pose(position, (1.0, 0.0, 0.0, 0.0))),
    invalid_vectors(4).map(lambda quaternion: Pose((0.4, 0.0, 0.2), quaternion)),
    st.just(Pose((0.4, 0.0, 0.2), (0.0, 0.0, 0.0, 0.0))),
)
BOOLS = st.one_of(st.none(), st.integers(), st.just(math.nan), st.just(np.True_))
INVALID: dict[Any, dict[str, st.SearchStrategy[Any]]] = {
    ARM: {
        "time_ns": INVALID_INTEGER,
        "base_T_tcp": INVALID_POSE,
        "joints_rad": st.one_of(st.none(), invalid_vectors(6)),
        "wrench": invalid_vectors(6),
        "mode": st.sampled_from([None, "running", 1]),
        "speed_fraction": st.one_of(INVALID_NUMBER, st.floats(1.1), st.floats(max_value=-0.1)),
    },
    GRIPPER: {
        "time_ns": INVALID_INTEGER,
        "activated": BOOLS,
        "moving": BOOLS,
        "opening_m": st.one_of(INVALID_NUMBER, st.floats(1.1), st.integers(2), st.integers(max_value=-2)),
        "fault_code": INVALID_INTEGER,
        "gripping": BOOLS,
        "obstructed": BOOLS,
        "current_a": INVALID_NUMBER,
        "raw": st.one_of(st.none(), INVALID_INTEGER.map(lambda value: {"position_counts": value})),
        "mode": st.sampled_from([None, 1, True]),
        "reclosed_from_m": INVALID_NUMBER,
    },
    HAND: {
        "holding": st.sampled_from([None, "held", True]),
        "what": st.sampled_from([None, 1]),
        "base_T_grasp": INVALID_POSE,
        "width_m": INVALID_NUMBER,
        "finger_opening_m": INVALID_NUMBER,
    },
}
FIELDS = [(state, field.name) for state in INVALID for field in fields(state)]


@pytest.mark.parametrize(("state", "name"), FIELDS, ids=lambda value: value if isinstance(value, str) else "")
@given(data=st.data())
def test_invalid_value_of_any_field_is_rejected(state: Any, name: str, data: st.DataObject) -> None:
    value = data.draw(INVALID[state][name])
    with pytest.raises(InvalidStateError, match=rf"{name}.* expected .*inspect the device"):
        replace(state, **{name: value})


def test_arm_state_without_a_required_value_is_rejected() -> None:
    assert issubclass(InvalidStateError, DeviceError)
    for name in ("time_ns", "base_T_tcp", "joints_rad", "mode"):
        with pytest.raises(InvalidStateError, match=f"{name} is None"):
            replace(ARM, **{name: None})
    state = replace(ARM, wrench=None)  # an arm without a force sensor
    with pytest.raises(InvalidStateError, match="wrench"):
        _ = state.force_n


SPEC = GripperSpec(0.1, 0.098, 1e-4, (0.01, 0.1), (10.0, 50.0))


def test_opening_far_outside_the_range_of_the_fingers_is_rejected() -> None:
    for opening_m in (0.1005, 0.0015):
        SPEC.require_possible(opening_m)
    for opening_m in (0.102, -0.001):
        with pytest.raises(InvalidStateError, match="opening_m"):
            SPEC.require_possible(opening_m)


@st.composite
def specs(draw: st.DrawFn) -> GripperSpec:
    """Grippers with a nominal or a measured range; some measured openings are equal."""
    steps = draw(st.integers(1, 400))
    resolution_m = draw(st.floats(1e-4, 2e-3))
    at = sorted(draw(st.sets(st.integers(0, 2 * steps), max_size=6)))
    measured_m = sorted((draw(st.integers(0, 100)) / 1e3 for _ in at), reverse=True)
    measured = tuple((half / 2, opening_m) for half, opening_m in zip(at, measured_m, strict=True))
    return GripperSpec(0.1, steps * resolution_m, resolution_m, (0.01, 0.1), (10.0, 50.0), measured)


@given(spec=specs())
def test_opening_and_position_in_counts_convert_both_ways(spec: GripperSpec) -> None:
    """For any measurement, openings decrease strictly, and each one is converted back to its position."""
    openings = [spec.opening_at(step) for step in range(spec.steps + 1)]
    assert [spec.step_at(opening_m) for opening_m in openings] == list(range(spec.steps + 1))
    assert all(more > less for more, less in pairwise(openings))
    assert (spec.open_m, spec.closed_m) == (openings[0], openings[-1])
    assert (spec.step_at(spec.open_m + 1.0), spec.step_at(spec.closed_m - 1.0)) == (0, spec.steps)
    for opening_m in (spec.open_m, spec.closed_m):
        spec.require_command(opening_m)


@given(spec=specs(), opening_m=st.floats(allow_nan=True))
def test_command_outside_the_range_is_refused(spec: GripperSpec, opening_m: float) -> None:
    if spec.closed_m - spec.resolution_m / 2 < opening_m < spec.open_m + spec.resolution_m / 2:
        return spec.require_command(opening_m)
    with pytest.raises(OutOfLimitsError, match="mm"):
        spec.require_command(opening_m)


@pytest.mark.parametrize(
    ("speed_m_s", "force_n"), [(0.2, None), (math.nan, None), (None, 5.0), (None, math.inf), (0.0, 20.0)]
)
def test_speed_or_force_outside_the_range_is_refused(speed_m_s: float | None, force_n: float | None) -> None:
    SPEC.require_command(0.05, 0.1, 10.0)
    with pytest.raises(OutOfLimitsError, match=r"m/s|N is"):
        SPEC.require_command(0.05, speed_m_s, force_n)
