"""Every public entry of `import rig` refuses invalid arguments, of any type, with a typed error."""

import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rig
from rig.contract_checks import gel

EMPTY = gel(80, 60)
FRAMES = [gel(80, 60, i) for i in range(3)]
TIMES = np.arange(20) / 30.0
ANGLES = rig.Angles(TIMES, 10.0 * TIMES)
SAMPLE = rig.estimator("ellipse", background=EMPTY).update(EMPTY, 0.5)
BOARD = np.array([(x, y) for y in np.arange(5) * 0.03 for x in np.arange(6) * 0.03])
(LIFT,) = rig.open_session(Path(__file__).resolve().parents[3] / "data/stored_trial")
POSES = np.tile(np.eye(4), (4, 1, 1))


class Still:
    """A valid estimator class of a user."""

    def __init__(self, background: object) -> None:
        pass

    def update(self, image: object, time_ns: int) -> None:
        return None


def ragged() -> Any:
    recursive: list[Any] = [1.0]
    recursive.append(recursive)
    return recursive


VALUES = (
    None, True, False, "", "x", "0.5", "\0", "a" * 5000, "\udc80", "nan", b"", b"x", 0, 1, -1, 2, 3,
    10**400, -(10**400), 0.0, -0.0, 2.5, -1.0, float("nan"), float("inf"), -float("inf"), 1e308, -1e308,
    1e-308, 1j, Fraction(1, 3), Decimal("1.5"), Decimal("NaN"), datetime(2020, 1, 1), Path("x"),
    Path("a\0b"), len, int, object, type, Exception, Still, Still(EMPTY), ValueError("x"), NotImplemented,
    Ellipsis, slice(3), range(3), np.float16(30.0), np.float16(1e4), np.float32("nan"), np.float64(1e308),
    np.longdouble("1e400"), np.int8(3), np.uint64(2**64 - 1), np.bool_(True), np.str_("0.5"),
    np.datetime64("2020-01-01"), np.timedelta64(1, "s"), np.complex128(1j), (), (640, 480), (1, 2, 3), ANGLES,
)  # fmt: skip
TYPES: tuple[Callable[[], Any], ...] = (
    *(lambda value=value: value for value in VALUES), list, dict, set, object, ragged, threading.Lock,
    lambda: [None], lambda: ["0.1", "0.2"], lambda: [[1.0], [1.0, 2.0]], lambda: [10**400], lambda: {1: 2},
    lambda: {1.0}, lambda: [0.0, 1.0, 2.0], lambda: iter([]), lambda: iter([1, 2]),
    lambda: (x for x in (0.0, 1.0)), lambda: memoryview(b"abc"), lambda: bytearray(3), lambda: np.zeros(0),
    lambda: np.array(3.0), lambda: np.zeros((2, 2)), lambda: np.full(3, np.nan), lambda: np.full(20, 1e308),
    lambda: np.zeros(3, "U3"), lambda: np.zeros(3, "M8[s]"), lambda: np.zeros(3, complex),
    lambda: np.array([1, None]), lambda: np.zeros(20, bool), lambda: np.zeros((3, 4, 4)),
    lambda: np.full((4, 4, 4), np.nan), lambda: np.full((4, 4, 4), 1e308), lambda: np.zeros((60, 80, 3)),
    lambda: np.zeros((60, 80, 3), np.uint8), lambda: np.zeros((60, 80), np.uint8),
    lambda: np.zeros((0, 0, 3), np.uint8), lambda: np.zeros((3, 60, 80, 3), np.uint8),
    lambda: np.ma.masked_equal([0.0, 1.0, 2.0], 1.0), lambda: [np.zeros((60, 80, 3), np.uint8)] * 3,
    lambda: [BOARD] * 3, lambda: np.zeros(3, [("a", float)]),
)  # fmt: skip
"""Makers of values of many types, valid and invalid, because an iterator can be read only once."""


def live(**arguments: Any) -> Any:
    given: dict[str, Any] = {"background": EMPTY, **arguments}
    return rig.estimator("ellipse", **given)


def updated(**arguments: Any) -> None:
    live().update(**{"image": FRAMES[0], "time_s": 0.5} | arguments)


def updated_at(**arguments: Any) -> None:
    live().update_at(**{"image": FRAMES[0], "time_ns": 5} | arguments)


def referenced(**arguments: Any) -> None:
    stream = live()
    stream.update(FRAMES[0], 0.0)
    stream.set_reference(**arguments)


def checked(**arguments: Any) -> None:
    live().check_background(**arguments)


def made(**arguments: Any) -> None:
    rig.StreamingEstimator(**{"estimator": Still(EMPTY), "shape": EMPTY.shape} | arguments)


def of_one(**arguments: Any) -> rig.Angles:
    return rig.Angles.of([replace(SAMPLE, **arguments)])


ENTRIES: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "open_session": (rig.open_session, {"folder": "none"}),
    "Session": (rig.Session, {"folder": "none"}),
    "estimate": (
        rig.estimate,
        {"frames": FRAMES, "background": EMPTY, "times_s": None, "fps": 30.0, "estimator": "ellipse",
         "window": None, "pixel_aspect": None, "gel": None},
    ),
    "estimator": (
        rig.estimator,
        {"name": "ellipse", "background": EMPTY, "window": None, "pixel_aspect": None, "sign": 1,
         "gel": None},
    ),
    "StreamingEstimator": (
        rig.StreamingEstimator,
        {"estimator": Still(EMPTY), "shape": EMPTY.shape, "sign": 1, "each_contact": False},
    ),
    "update": (updated, {"image": FRAMES[0], "time_s": 0.5}),
    "update_at": (updated_at, {"image": FRAMES[0], "time_ns": 5}),
    "set_reference": (referenced, {"time_s": 0.1}),
    "check_background": (checked, {"background": EMPTY}),
    "tip": (LIFT.tip, {"serial": LIFT.serials[0]}),
    "frames": (LIFT.frames, {"serial": LIFT.serials[0], "masks": None}),
    "background": (LIFT.background, {"serial": LIFT.serials[0]}),
    "sign": (LIFT.sign, {"serial": LIFT.serials[0]}),
    "pixel_aspect": (LIFT.pixel_aspect, {"serial": LIFT.serials[0]}),
    "lift.estimator": (LIFT.estimator, {"serial": LIFT.serials[0]}),
    "Angles": (
        rig.Angles,
        {"time_s": TIMES, "angle_deg": TIMES, "sigma_deg": TIMES, "states": (), "contact_area_px": TIMES,
         "source": "", "zero_ns": 0},
    ),
    "Angles.of": (rig.Angles.of, {"samples": [SAMPLE], "source": "", "zero_ns": 0}),
    "Angles.of one sample": (of_one, {"time_ns": 5, "state": SAMPLE.state, "angle_deg": 1.0,
        "sigma_deg": 1.0, "contact_area_px": 9.0}),
    "Angles.between": (ANGLES.between, {"from_ns": 0, "until_ns": 10**8}),
    "Angles.picked": (ANGLES.select, {"which": TIMES > 0.1}),
    "Angles.at": (ANGLES.at, {"time_s": 0.1}),
    "Angles.at_ns": (ANGLES.at_ns, {"time_ns": 10**8}),
    "score": (rig.score, {"estimate": ANGLES, "truth": ANGLES}),
    "solve_camera": (
        rig.solve_camera, {"board_m": [BOARD] * 3, "image_px": [1e3 * BOARD + 50] * 3, "size_px": (640, 480)},
    ),
    "solve_hand_eye": (
        rig.solve_hand_eye, {"base_T_tcp": POSES, "camera_T_target": POSES, "setup": "eye-to-hand"},
    ),
}  # fmt: skip
PARAMETERS = [(entry, name) for entry, (_, valid) in ENTRIES.items() for name in valid]


def answer(entry: str, arguments: dict[str, Any]) -> None:
    """Call an entry. Only the errors of the rig are expected."""
    call, valid = ENTRIES[entry]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=UserWarning)  # a background may look like a contact
        with suppress(rig.RigError):
            call(**valid | arguments)


@pytest.mark.heavy
@pytest.mark.parametrize(("entry", "name"), PARAMETERS)
def test_value_of_any_type_is_accepted_or_a_typed_error(entry: str, name: str) -> None:
    for make in TYPES:
        answer(entry, {name: make()})


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(data=st.data())
def test_any_combination_of_values_is_accepted_or_a_typed_error(data: st.DataObject) -> None:
    entry = data.draw(st.sampled_from(sorted(ENTRIES)))
    names = data.draw(st.sets(st.sampled_from(sorted(ENTRIES[entry][1])), min_size=1))
    number = st.integers() | st.floats() | st.fractions() | st.complex_numbers()
    scalar = number | st.none() | st.text(max_size=5) | st.binary(max_size=5) | st.booleans()
    rows = st.lists(scalar, max_size=4) | st.lists(st.lists(number, max_size=3), max_size=3)
    value = st.sampled_from(TYPES).map(lambda make: make()) | scalar | rows
    answer(entry, {name: data.draw(value) for name in sorted(names)})


NAN, INF, SHORT = float("nan"), float("inf"), np.zeros((60, 80))
MASKED = np.ma.masked_equal([0.0, 0.1, 0.2], 0.1)
OTHER_SIZE = np.zeros((60, 90, 3), np.uint8)
UNKNOWN, ENDLESS, FAR = np.full((30, 2), NAN), np.full((30, 2), INF), np.full((30, 2), 1e9)
REFUSED = {
    ("estimate", "pixel_aspect"): (-1, 0, NAN, INF, 1000, "1", True, [1.0]),
    ("estimator", "pixel_aspect"): (-1.0, NAN, 1000.0, "square"),
    ("estimate", "fps"): ("30", None, True, NAN, -1, 1e-9, 1e9, 10**400, 1j, [30.0]),
    ("estimate", "window"): (2.5, 0, -1, 101, "2", True, NAN, np.float64(2.0), 10**400),
    ("estimate", "times_s"): (
        "text", ["0.0", "0.1", "0.2"], ["a", "b", "c"], [0.0, None, 0.2], [0.0, NAN, 0.2], [[0.0, 0.1]],
        np.zeros(3, "M8[s]"), [0.0, 1.0, 10**400], 3.0, [True, False, True], MASKED,
    ),
    ("estimate", "frames"): (None, 3, len, {1: 2}, b"frames", "frames"),
    ("estimate", "estimator"): (None, "", 3, [], Still(EMPTY), "no such"),
    ("estimate", "background"): ("empty.png", 3, SHORT, [EMPTY]),
    ("estimate", "gel"): (3, "", "none.yaml", b"x", "a\0b", True),
    ("estimator", "sign"): (0, 2, None, "1", True, np.array([1, -1]), NAN),
    ("estimator", "window"): (2.5, 0, "2"),
    ("update", "time_s"): ("0.5", None, True, 10**400, NAN, [0.5], 1e300),
    ("update_at", "time_ns"): (0.5, None, "5", True, 2**70),
    ("update_at", "image"): (None, SHORT, OTHER_SIZE),
    ("set_reference", "time_s"): ("0.5", 10**400, INF, [0.1]),
    ("check_background", "background"): (None, OTHER_SIZE),
    ("StreamingEstimator", "estimator"): (None, "slip", Still, object()),
    ("StreamingEstimator", "shape"): (None, (60, 80), (60, 80, 1), (60.5, 80, 3), "abc", 3),
    ("StreamingEstimator", "each_contact"): (None, 1, "no"),
    ("open_session", "folder"): (None, 3, "", b"x", "a\0b", [], "a" * 5000, "\udc80\0"),
    ("tip", "serial"): (None, 3, "", "no such", b"x", [], np.array(["a", "b"])),
    ("frames", "serial"): (None, 3, [], np.array(["camera", "b"])),
    ("frames", "masks"): (3, [], b"x", "", "no such"),
    ("Angles", "angle_deg"): (None, ["1"] * 20, np.full(20, INF), np.full(20, 1e308), 1j),
    ("Angles", "sigma_deg"): (-TIMES - 1, ["a"] * 20, None),
    ("Angles", "states"): (None, "t" * 20, 3, [1] * 20),
    ("Angles", "source"): (None, 3, b"x", [], TIMES),
    ("Angles", "zero_ns"): (None, 0.5, "5", True, 2**70, -(10**400), NAN),
    ("Angles.of", "samples"): (None, 3, "x", [None], [3], {1: 2}, ANGLES, TIMES),
    ("Angles.of", "source"): (None, 3, []),
    ("Angles.of", "zero_ns"): (None, 0.5, "5", 10**400),
    ("Angles.of one sample", "time_ns"): (None, 0.5, "5", 2**70),
    ("Angles.of one sample", "state"): (None, 3, "tracking"),
    ("Angles.of one sample", "angle_deg"): ("1", [1.0], INF, 1j, b"x"),
    ("Angles.of one sample", "sigma_deg"): (-1.0, "1", [1.0]),
    ("Angles.of one sample", "contact_area_px"): ("1", [1.0]),
    ("Angles.between", "from_ns"): (None, 0.5, "5", True, 10**400, [0]),
    ("Angles.between", "until_ns"): (None, INF, "x", TIMES),
    ("Angles.picked", "which"): (
        None, True, "x", [0, 1], slice(3), range(20), TIMES, np.zeros(19, bool), np.zeros((20, 1), bool),
    ),
    ("Angles.at", "time_s"): (None, "x", "0.1", ["0.1"], NAN, [0.1, INF], 10**400, True, 1e300, {1: 2}),
    ("Angles.at_ns", "time_ns"): (None, 0.5, "5", True, 10**400, NAN, [1]),
    ("score", "estimate"): (None, TIMES, (TIMES, TIMES), 3),
    ("score", "truth"): (None, TIMES),
    ("solve_camera", "board_m"): (None, 3, "board", [None] * 3, [UNKNOWN] * 3, [FAR] * 3),
    ("solve_camera", "image_px"): (None, ["x"] * 3, [ENDLESS] * 3, [FAR] * 3, iter([])),
    ("solve_camera", "size_px"): (
        None, 640, (640,), (640.5, 480), (0, 480), ("640", "480"), (10**400, 480), (-640, 480), "12",
    ),
    ("solve_hand_eye", "base_T_tcp"): (None, "poses", POSES * NAN, np.eye(4), [["1"] * 4] * 4),
    ("solve_hand_eye", "setup"): (None, 3, "", "eye", [], np.array(["eye-to-hand"] * 2)),
}  # fmt: skip


@pytest.mark.parametrize(("entry", "name"), REFUSED)
def test_invalid_argument_is_refused(entry: str, name: str) -> None:
    call, valid = ENTRIES[entry]
    for value in REFUSED[entry, name]:
        with pytest.raises(rig.InputError):
            call(**valid | {name: value})


def test_result_of_an_estimator_that_is_no_sample_is_refused() -> None:
    stream = rig.StreamingEstimator(Still(EMPTY), EMPTY.shape)  # type: ignore[arg-type]
    with pytest.raises(rig.InputError, match=r"result of update is None: give a rig\.SlipSample"):
        stream.update(FRAMES[0], 0.0)


def test_rates_and_times_of_any_numeric_type_are_used_as_floats() -> None:
    for fps in (30, np.float16(30), np.int8(30), np.float32(30.0), Fraction(30), np.float64(30)):
        angles = rig.estimate(FRAMES, EMPTY, fps=fps, estimator="ellipse")  # type: ignore[arg-type]
        assert angles.time_s.tolist() == pytest.approx([0.0, 1 / 30, 2 / 30], abs=1e-8)
    whole = (np.arange(3, dtype=kind) for kind in (np.int8, np.float16))
    for times in ([0, 1, 2], range(3), (0.0, 1.0, 2.0), *whole):
        assert rig.estimate(FRAMES, EMPTY, times_s=times, estimator="ellipse").time_s.tolist() == [0, 1, 2]
