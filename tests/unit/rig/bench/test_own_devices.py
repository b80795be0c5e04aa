"""User-defined drivers in a bench file: how they are created, and which faults the bench reports."""

import sys
from collections.abc import Iterator
from inspect import get_annotations
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from drivers.bench import Bench
from drivers.errors import (
    DamagedFrameError,
    DeviceError,
    DeviceTimeoutError,
    InputError,
    InvalidStateError,
    OutOfLimitsError,
)
from drivers.interfaces import Arm, Camera, Gripper, TactileSensor
from drivers.types import (
    ArmLimits,
    ArmMode,
    ArmState,
    Frame,
    GripperSpec,
    GripperState,
    HandState,
    Holding,
    Pose,
)
from fakes.clock import SimulatedClock
from protocols.readiness import check_hand
from protocols.safe_end import halt, make_safe
from rig.bench.assembly import TOOL_DOWN, build_real_bench
from rig.bench.own_devices import CheckedArm, CheckedGripper, CheckedSource
from rig.bench.plan import PlannedMotion, make_plan
from rig.bench.source import unconnected_bench
from rig.config import BenchConfig
from rig.config.load import parse_bench
from rig.config.write import bench_text
from support.benches import real_bench
from support.own_devices import MODULE, OF_OUR_DRIVERS, SOURCE
from support.own_estimators import forget

TARGET = Pose.from_rotation((0.5, 0.1, 0.2), TOOL_DOWN)


@pytest.fixture(autouse=True)
def imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "imported"
    sys.modules.pop(MODULE, None)
    forget()


def values(**options: dict[str, Any]) -> dict[str, Any]:
    """A real bench with user-defined drivers only. options: of the devices, by section."""
    bench = parse_bench(real_bench(), "file").model_dump(exclude={"calibrations"}, exclude_unset=True)
    for section, theirs in OF_OUR_DRIVERS.items():
        bench[section] = {key: value for key, value in bench[section].items() if key not in theirs}
    limits = bench["arm"]["limits"]
    bench["arm"]["limits"] = {key: value for key, value in limits.items() if "joint" not in key}
    bench["arm"]["driver"], bench["gripper"]["driver"] = f"{MODULE}:Plain", f"{MODULE}:Fingers"
    for sensor in (*bench["tactile"], bench["camera"]):
        sensor["driver"] = f"{MODULE}:Gel"
    bench["camera"]["size_px"] = (240, 320)
    for section, of in options.items():
        bench[section]["options"] = of
    return bench


def config(**options: dict[str, Any]) -> BenchConfig:
    return BenchConfig.model_validate(values(**options))


def bench(**options: dict[str, Any]) -> Bench:
    return build_real_bench(config(**options))


def test_bench_file_with_user_drivers_is_read_back_without_importing_them(imported: Path) -> None:
    made = config(arm={"stuck": False, "ports": [1, 2], "tuning": {"gain": 0.5, "name": 'a "b"'}})
    tip = made.tactile[0].model_copy(update={"options": {"behaviour": "frames", "deep": {"x": [True]}}})
    made = made.model_copy(update={"tactile": (tip, made.tactile[1])})
    again = parse_bench(bench_text(made), "file")
    assert again.arm.options == made.arm.options
    assert again.tactile[0].options == made.tactile[0].options
    assert (again.simulated, again.in_process) == (False, False)
    assert BenchConfig.model_validate_json(made.model_dump_json()) == made
    assert not imported.exists()
    stored = config(camera={"behaviour": "http://me:secret@10.0.0.2/stream"}).without_passwords()
    assert "secret" not in stored.model_dump_json()
    assert stored.arm.options == {}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f'"{MODULE}:Plain"', "'ur6'", "must be 'fake' or 'ur5e', or a class of your own"),
        (f'"{MODULE}:Plain"', "'ur5e'\noptions = {a = 1}", "options: has no effect with driver 'ur5e'"),
        ("[arm]", '[fakes]\ncontrol = "127.0.0.1:9"\n[arm]', "this is a real bench: remove it"),
        (f"{MODULE}:Fingers", "fake", "make all of them real or all simulated"),
    ],
)
def test_bench_with_user_drivers_is_never_simulated_and_other_drivers_have_no_options(
    old: str, new: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        parse_bench(bench_text(config()).replace(old, new), "file")


@pytest.mark.parametrize(
    ("section", "change", "message"),
    [
        ("arm", {"driver": "nowhere.at_all:Arm"}, "there is no module nowhere; install its package"),
        ("arm", {"driver": "my_arm.py:Arm"}, "there is no file my_arm.py; give .* as my_arm:Arm"),
        ("arm", {"driver": f"{MODULE}:Careless"}, "accepts no argument payload_kg"),
        ("arm", {"options": {"sped": 3}}, "accepts no option sped; it accepts limits"),
        ("arm", {"options": {"limits": 3}}, "options contains limits, which the rig sets itself"),
        ("arm", {"host": "10.0.0.1"}, "accepts no argument host"),
        ("gripper", {"port": 503}, "accepts no argument port"),
        ("camera", {"driver": f"{MODULE}:Half"}, "does not implement newest_frame"),
        ("camera", {"driver": f"{MODULE}:Motion"}, "does not implement connect, disconnect"),
        ("camera", {"address": "/dev/video7"}, "accepts no argument address"),
    ],
)
def test_invalid_driver_configuration_is_rejected_before_connecting(
    section: str, change: dict[str, Any], message: str
) -> None:
    changed = values()
    changed[section] |= change
    with pytest.raises(InputError, match=message):
        build_real_bench(BenchConfig.model_validate(changed))


def test_bench_file_limits_are_checked_before_the_driver_is_called() -> None:
    arm = bench().arm
    keep_out = arm.limits.keep_out
    assert [box.name for box in keep_out] == ["table"]
    for target, speed in ((TARGET.translated(x_m=2.0), 0.1), (TARGET, 9.0), (TARGET, float("nan")),
                          (TARGET.translated(z_m=-0.18), 0.1)):  # fmt: skip
        with pytest.raises(OutOfLimitsError):
            arm.move_linear(target, speed, 0.5)
    arm.move_linear(TARGET, 0.1, 0.5).wait(1.0)
    assert arm._driver.heard == ["move"]  # type: ignore[attr-defined]
    gripper = bench().gripper
    for opening_m in (0.121, -0.036, 100.0, float("nan")):
        with pytest.raises(OutOfLimitsError, match="mm"):
            gripper.move_to(opening_m)
    for speed_m_s, force_n in ((0.5, 20.0), (0.05, 5.0)):
        with pytest.raises(OutOfLimitsError, match=r"m/s|N is"):
            gripper.move_to(0.05, speed_m_s, force_n)
    assert gripper.state().opening_m == 0.12
    gripper.move_to(0.05).wait(1.0)
    assert gripper.state().opening_m == 0.05


def test_invalid_driver_answers_and_exceptions_are_device_errors() -> None:
    for behaviour, problem in (
        ("nothing", "raised TypeError: NoneType instead of ArmState.*fix the"),
        ("unvalidated", "raised TypeError: SimpleNamespace instead of ArmState.*fix the"),
        ("nan", "joints_rad is .*check"),
    ):
        with pytest.raises(DeviceError, match=f"arm: driver '{MODULE}:Plain': state.* {problem} .*driver"):
            bench(arm={"behaviour": behaviour}).arm.state()
    with pytest.raises(DeviceError, match="str instead of Motion"):
        bench(arm={"behaviour": "no motion"}).arm.move_linear(TARGET, 0.1, 0.5)


@pytest.mark.parametrize("opening_m", [float("nan"), -5, 0.124, True, 120.0, "0.12"])
def test_invalid_opening_never_frees_a_hand_that_holds(opening_m: Any) -> None:
    made = bench(gripper={"at": opening_m})
    held = HandState(Holding.HELD, "wrench", TARGET, 0.012)
    made.hand.note(held)
    with pytest.raises(InvalidStateError, match=f"gripper: driver '{MODULE}:Fingers': state: .*opening_m"):
        check_hand(made)
    assert made.hand.state == held


def test_arm_without_wrench_is_rejected_unless_the_bench_file_declares_it() -> None:
    silent = {"behaviour": "no wrench"}
    with pytest.raises(InvalidStateError, match=r"has no wrench.*write force_sensor = false"):
        bench(arm=silent).arm.state()
    assert build_real_bench(without_force_sensor(arm=silent)).arm.state().wrench is None
    with pytest.raises(InvalidStateError, match="has a wrench, but the bench file has force_sensor = false"):
        build_real_bench(without_force_sensor()).arm.state()


def without_force_sensor(**options: dict[str, Any]) -> BenchConfig:
    changed = values(**options)
    changed["arm"]["force_sensor"] = False
    del changed["arm"]["limits"]["max_contact_force_n"]
    return BenchConfig.model_validate(changed)


@pytest.mark.parametrize(("ahead_s", "message"), [(-1.0, r"1\.0\d s old"), (0.5, "in the future")])
def test_state_that_is_old_or_from_the_future_is_rejected(ahead_s: float, message: str) -> None:
    made = bench(arm={"ahead_s": ahead_s}, gripper={"ahead_s": ahead_s})
    for state in (made.arm.state, made.gripper.state):
        with pytest.raises(DeviceError, match=message):
            state()


def test_missing_force_sensor_is_declared_once_stored_and_named_in_the_plan() -> None:
    made = without_force_sensor()
    assert parse_bench(bench_text(made), "file").arm.force_sensor is False
    assert BenchConfig.model_validate_json(made.model_dump_json()) == made
    with pytest.raises(InputError, match=r"max_contact_force_n: is missing: write by how much"):
        parse_bench(bench_text(made).replace("force_sensor = false", ""), "file")
    useless = bench_text(config()).replace("[arm]\n", "[arm]\nforce_sensor = false\n")
    with pytest.raises(InputError, match="max_contact_force_n: has no effect with force_sensor = false"):
        parse_bench(useless, "file")
    motion = PlannedMotion("home", TARGET, (TARGET,), 0.1)
    guarded, unguarded = (make_plan(of, [], [motion]).text() for of in (config(), made))
    assert "20 N on the way down" in guarded
    assert "NOT GUARDED" not in guarded
    assert "no force limit on the way down" in unguarded
    assert "WARNING: the arm has no force sensor" in unguarded
    assert "NOT GUARDED" in make_plan(made, ["steps by keys"], []).text()


def test_wait_that_fails_stops_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    made, stopped = bench(arm={"stuck": True}), []
    monkeypatch.setattr(made.arm._driver, "stop", lambda: stopped.append("arm"))  # type: ignore[attr-defined]
    said = r"is_done raised KeyError: 'joint 3' \(.*, line \d+: raise KeyError"
    with pytest.raises(DeviceError, match=said):
        made.arm.move_linear(TARGET, 0.1, 0.5).wait(1.0)
    assert stopped == ["arm"]


def test_failed_arm_stop_is_reported_and_fingers_are_still_held(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck, held = bench(arm={"stuck": True}), []
    monkeypatch.setattr(stuck.gripper._driver, "stop", lambda: held.append(True))  # type: ignore[attr-defined]
    assert "line dead" in make_safe(stuck)
    with pytest.raises(DeviceError, match="line dead"):
        halt(stuck)
    assert held
    assert "press the emergency stop" in caplog.text


@pytest.mark.parametrize(
    ("behaviour", "error", "match"),
    [
        ("crash", DeviceError, "next_frame raised ZeroDivisionError"),
        ("late", DeviceTimeoutError, "no frame came"),
        ("another", DeviceError, "a frame of 'of another sensor'"),
        ("small", DamagedFrameError, r"uint8 \(160, 240, 3\), but .* requires uint8 \(320, 240, 3\)"),
        ("float", DamagedFrameError, "float64"),
        ("text", DeviceError, "time_ns is 'now', expected an int"),
        ("array", DeviceError, "next_frame raised TypeError: ndarray instead of Frame"),
    ],
)
def test_invalid_frame_is_rejected(behaviour: str, error: type[Exception], match: str) -> None:
    camera = bench(camera={"behaviour": behaviour}).camera
    with pytest.raises(error, match=match):
        camera.next_frame(0.1)


POSE = Pose((0.4, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
LIMITS = ArmLimits((0.0, -1.0, 0.0), (1.0, 1.0, 1.0), 0.5, 1.0, 5.0)
SPEC = GripperSpec(0.1, 0.1, 1e-4, (0.01, 0.1), (10.0, 50.0))
CLOCK = SimulatedClock()
FRAME = Frame(np.zeros((4, 3, 3), np.uint8), 1, 1, "S1")
ANSWERS = {
    "next_frame": FRAME, "newest_frame": FRAME, "identity": {"model": "M"}, "counters": {"lost": 2},
    "round_trips_s": (0.01,), "clock_offset_s": 0.5, "speed_fraction": 0.4,
}  # fmt: skip
ARGUMENTS = {
    "move_linear": (POSE, 0.1, 0.5), "recover": (print,), "move_to": (0.05, 0.05, 20.0), "next_frame": (0.1,),
    "newest_frame": (0.1,), "set_light": (1.0, 1.0, 1.0),
}  # fmt: skip
FROM_THE_BENCH_FILE = {"limits": LIMITS, "spec": SPEC, "serial": "S1", "rate_hz": 30.0, "waits": False}
"""Members that are answered without the driver."""


def driver(state: Any = None, **answers: Any) -> Mock:
    """Return a driver with every method."""
    made = Mock()
    for name, answer in {**ANSWERS, "state": state, **answers}.items():
        getattr(made, name).return_value = answer
    return made


SENSOR = CheckedSource, ("S1", 30.0, (3, 4)), None
CHECKED: dict[type[Any], tuple[Any, tuple[Any, ...], Any]] = {
    Arm: (CheckedArm, (LIMITS, CLOCK), ArmState(1, POSE, AT_REST, AT_REST, ArmMode.RUNNING)),
    Gripper: (CheckedGripper, (SPEC, CLOCK), GripperState(1, True, False, 0.05)),
    TactileSensor: SENSOR,
    Camera: SENSOR,
}
"""By interface: the class, its arguments after the driver and its name, and the driver's state."""


@pytest.mark.parametrize("protocol", CHECKED)
def test_checked_device_forwards_every_member(protocol: type[Any]) -> None:
    """So that a new member of an interface cannot be forgotten."""
    checked, arguments, state = CHECKED[protocol]
    members = {name for base in protocol.__mro__ for name in (*vars(base), *get_annotations(base))}
    for name in sorted(name for name in members if name[0] != "_"):
        of = driver(state)
        made = getattr(checked(of, "lab:Device", *arguments), name)
        if name in FROM_THE_BENCH_FILE:
            assert made == FROM_THE_BENCH_FILE[name]
            assert not of.mock_calls
            continue
        given = ARGUMENTS.get(name, ())
        answer = made(*given)
        getattr(of, name).assert_called_once_with(*given)
        assert name not in ANSWERS or name == "identity" or answer is ANSWERS[name]


@pytest.mark.parametrize("fraction", [float("nan"), 7, True, "full"])
def test_invalid_speed_fraction_is_rejected(fraction: Any) -> None:
    with pytest.raises(DeviceError, match=r"lab:Arm.*speed_fraction"):
        CheckedArm(driver(speed_fraction=fraction), "lab:Arm", LIMITS, CLOCK).speed_fraction()


def test_optional_driver_methods_default_to_unknown() -> None:
    made = bench()
    with pytest.raises(DeviceError, match="teach with --by keys"):
        made.arm.begin_guiding()
    made.arm.end_guiding()
    assert made.camera.identity() == {"driver": f"{MODULE}:Gel"}
    assert made.camera.counters() == {}
    assert made.camera.clock_offset_s() is made.arm.speed_fraction() is None
    assert made.camera.next_frame(0.1).serial == made.camera.serial == "camera"
    assert made.camera.rate_hz == 30.0
    with unconnected_bench(config()) as looked_at:
        assert looked_at.simulated is False
