"""The simulated gripper's state machine, tick by tick, compared with the manual."""

import pytest

from drivers.types import Pose
from fakes.faults import DRIFT_COUNTS
from fakes.objects.catalogue import find_object
from fakes.wire.gripper.server import GripperModel
from fakes.world.motion import ToolPath
from fakes.world.world import FINGER_STIFFNESS_N_M, World
from support.worlds import HOME, TABLE, empty_world


def run(model: GripperModel, written: str, start_ns: int, duration_s: float) -> int:
    """Write bytes into a model and let it run; return the time after."""
    data = bytes.fromhex(written)
    model.written[: len(data)] = data
    end = start_ns + round(duration_s * 1e9)
    for now in range(start_ns, end, 5_000_000):
        model.tick(now)
    return end


def ready_model(world: World) -> tuple[GripperModel, int]:
    model = GripperModel(world, 0, ("B", "C"), activation_s=3.0)
    now = run(model, "01", 0, 6.0)
    assert model.image[:3] == b"\x31\0\0"
    return model, now


@pytest.mark.parametrize("before", [(), ("01",), ("01", "00", "01")])
def test_action_is_delayed_until_activation_is_complete(before: tuple[str, ...]) -> None:
    """Manual, FAULT STATUS 0x05: the activation must be completed prior to the action, which is delayed.

    rACT and rGTO may come together, as the ROS controller and robotiq3f_py send them, or one after the
    other: until the activation is over gGTO reads 0 ("or performing activation") and gFLT 5.
    """
    model, now = GripperModel(empty_world(), 0, ("B", "C"), activation_s=3.0), 0
    for written in before:
        now = run(model, written, now, 0.1)
    for _ in range(3):  # the ROS node sends its command again and again
        now = run(model, "09 00 00 30 FF FF", now, 0.1)
        assert (model.image[0], model.image[2]) == (0x11, 0x05)
    now = run(model, "09 00 00 30 FF FF", now, 6.0)
    assert (model.image[0], model.image[2], model.image[4]) == (0xF9, 0x00, 0x30)


def test_finger_in_contact_moves_only_when_opened_or_pressed_harder() -> None:
    """Manual, OBJECT STATUS; two of three fingers stopped early is gSTA 1."""
    world = empty_world()
    world.place(find_object("t1"))
    world.tool = ToolPath.resting(Pose(TABLE.position_m, HOME.quaternion_xyzw))
    model, now = ready_model(world)

    def grip(position: int, force: int, go_to: int = 8) -> int:
        asked = f"{position:02X} FF {force:02X}"
        return run(model, f"{1 | go_to:02X} 04 00 06 FF 00 {asked} {asked}", now, 3.0)

    now = grip(0xFF, 0)
    assert (model.image[0] >> 6, model.image[1]) == (1, 0b11_10_10_11)
    held = model.image[7]
    assert FINGER_STIFFNESS_N_M * world.squeeze_at(now) == pytest.approx(15.0, abs=1.0)
    now = grip(0xFE, 0)
    assert model.image[7] == held
    now = grip(0xFE, 20)
    pressed = model.image[7]
    assert pressed > held
    now = grip(0x40, 20)
    assert (model.image[7], model.image[0] >> 6) == (0x40, 3)
    now = grip(0xFE, 20)
    assert model.image[7] == pytest.approx(pressed, abs=2)
    now = grip(0xFE, 20, go_to=0)
    assert model.image[1] == 0
    grip(0xFE, 20)
    assert model.image[1] == 0b11_10_10_11


def test_late_tick_stops_the_fingers_at_the_object() -> None:
    """A busy computer misses refreshes; the object does not give way for that."""
    world = empty_world()
    world.place(find_object("t1"))
    world.tool = ToolPath.resting(Pose(TABLE.position_m, HOME.quaternion_xyzw))
    model, now = ready_model(world)
    now = run(model, "09 04 00 06 FF 00 FF FF 00 FF FF 00", now, 0.1)
    model.tick(now + 1_800_000_000)
    assert model.image[1] == 0b11_10_10_11
    assert FINGER_STIFFNESS_N_M * world.squeeze_at(now + 1_800_000_000) == pytest.approx(15.0, abs=1.0)


def test_drifting_fingers_open_once_without_a_command() -> None:
    model, now = ready_model(empty_world())
    now = run(model, "09 00 00 80 FF 00", now, 4.0)
    before = model.image
    assert before[7] == 0x80
    model.faults = frozenset(("drift",))
    now = run(model, "09 00 00 80 FF 00", now, 2.0)
    assert [model.image[place] for place in (7, 10)] == [0x80 - DRIFT_COUNTS] * 2
    run(model, "09 00 00 80 FF 00", now, 2.0)
    assert model.image[7] == 0x80 - DRIFT_COUNTS
    assert model.image[4] == 0x80, "the third finger stays"


@pytest.mark.parametrize(("code", "stops"), [(0x0B, False), (0x0D, True)])
def test_major_fault_stops_the_fingers(code: int, stops: bool) -> None:
    """Manual, FAULT STATUS: from 0x0D on the gripper needs a reset; minor faults need none."""
    model, now = ready_model(empty_world())
    now = run(model, "09 00 00 FF 40 00", now, 0.5)
    model.fail(code, now)
    at = model.image[4]
    assert 0 < at < 0xA0
    now = run(model, "09 00 00 FF 40 00", now, 2.0)
    assert (model.image[4] <= at + 2) == stops
