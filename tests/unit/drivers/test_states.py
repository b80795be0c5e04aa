"""Invalid values cannot become a state: NaN, infinity, wrong types, lengths and ranges are rejected."""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceError, InvalidStateError
from drivers.types import ArmMode, ArmState, GripperLimits, GripperState, HandState, Holding, Pose

AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ARM = ArmState(1, Pose((0.4, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0)), AT_REST, AT_REST, ArmMode.RUNNING, 1.0)
GRIPPER = GripperState(1, True, False, 120, 4, 0)
HAND = HandState(Holding.HELD, "wrench", ARM.base_T_tcp, 0.012, 120)

NOT_FINITE = st.sampled_from([math.nan, math.inf, -math.inf, np.float64("nan")])
NO_NUMBER = st.one_of(st.booleans(), st.text(max_size=3), st.just(np.float32(1.0)), st.just([1.0]))
INVALID_NUMBER = st.one_of(NOT_FINITE, NO_NUMBER, st.just(10**400))
INVALID_INTEGER = st.one_of(NOT_FINITE, NO_NUMBER, st.floats(), st.just(np.int64(3)))


@st.composite
def invalid_vectors(draw: st.DrawFn, length: int) -> Any:
    """Tuples of a wrong length or with an invalid number, and values that are no tuples."""
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
        "position_counts": st.one_of(INVALID_INTEGER, st.integers(max_value=-1)),
        "current_counts": INVALID_INTEGER,
        "fault_code": INVALID_INTEGER,
        "gripping": BOOLS,
        "obstructed": BOOLS,
    },
    HAND: {
        "holding": st.sampled_from([None, "held", True]),
        "what": st.sampled_from([None, 1]),
        "base_T_grasp": INVALID_POSE,
        "width_m": INVALID_NUMBER,
        "finger_counts": INVALID_INTEGER,
    },
}
FIELDS = [(state, field.name) for state in INVALID for field in fields(state)]


@pytest.mark.parametrize(("state", "name"), FIELDS, ids=lambda value: value if isinstance(value, str) else "")
@given(data=st.data())
def test_invalid_value_of_any_field_is_rejected(state: Any, name: str, data: st.DataObject) -> None:
    value = data.draw(INVALID[state][name])
    with pytest.raises(InvalidStateError, match=rf"{name}.* expected .*look at the device"):
        replace(state, **{name: value})


def test_invalid_state_is_a_device_error() -> None:
    assert issubclass(InvalidStateError, DeviceError)


def test_arm_without_force_sensor_has_no_force() -> None:
    state = replace(ARM, wrench=None)
    with pytest.raises(InvalidStateError, match="wrench"):
        _ = state.force_n


@pytest.mark.parametrize("name", ["time_ns", "base_T_tcp", "joints_rad", "mode"])
def test_arm_state_without_a_required_value_is_rejected(name: str) -> None:
    with pytest.raises(InvalidStateError, match=f"{name} is None"):
        replace(ARM, **{name: None})


@pytest.mark.parametrize(("counts", "possible"), [(0, False), (15, True), (1005, True), (1100, False)])
def test_position_far_outside_the_range_of_the_fingers_is_rejected(counts: int, possible: bool) -> None:
    limits = GripperLimits(20, 1000, 0.1, 1e-4)
    if possible:
        return limits.require_possible(counts)
    with pytest.raises(InvalidStateError, match="position_counts"):
        limits.require_possible(counts)
