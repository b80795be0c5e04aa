"""The register map of the 3-Finger gripper, compared with the frames printed in its manual."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceError, OutOfLimitsError
from drivers.robotiq_3f.registers import (
    AXES,
    AxisRequest,
    AxisState,
    Command,
    GraspMode,
    MotionStatus,
    ObjectStatus,
    Stage,
    Status,
    fault_code_text,
    force_counts,
    pack_command,
    speed_counts,
    unpack_status,
)

counts = st.integers(0, 255)
statuses = st.builds(
    Status,
    activated=st.booleans(),
    mode=st.sampled_from(GraspMode),
    go_to=st.booleans(),
    stage=st.sampled_from(Stage),
    motion=st.sampled_from(MotionStatus),
    fault=counts,
    axes=st.tuples(*[st.builds(AxisState, counts, counts, counts, st.sampled_from(ObjectStatus))] * 4),
)


def pack_status(status: Status) -> tuple[int, ...]:
    """Return the 8 registers of a status, the inverse of `unpack_status`."""
    gripper = status.activated | status.mode << 1 | status.go_to << 3
    gripper |= status.stage << 4 | status.motion << 6
    objects = sum(axis.status << 2 * number for number, axis in enumerate(status.axes))
    axes = [value for axis in status.axes for value in (axis.requested, axis.position, axis.current)]
    data = [gripper, objects, status.fault, *axes, 0]
    return tuple(high << 8 | low for high, low in zip(data[::2], data[1::2], strict=True))


def image(data: str) -> tuple[int, ...]:
    """8 registers from the bytes printed in the manual, the rest 0."""
    values = bytes.fromhex(data).ljust(16, b"\0")
    return tuple(int.from_bytes(values[at : at + 2], "big") for at in range(0, 16, 2))


EACH = (AxisRequest(1, 2, 3), AxisRequest(4, 5, 6), AxisRequest(7, 8, 9), AxisRequest(10, 11, 12))


def whole_hand(position: int) -> Command:
    asked = AxisRequest(position, speed=255, force=255)
    return Command(activate=True, go_to=True, axes=(asked, *[AxisRequest()] * 3))


@pytest.mark.parametrize(
    ("command", "written"),
    [
        (Command(activate=True), "01 00 00 00 00 00"),
        (whole_hand(255), "09 00 00 FF FF FF"),
        (whole_hand(0), "09 00 00 00 FF FF"),
        (Command(), "00 00 00 00 00 00"),
        (
            Command(True, GraspMode.WIDE, True, individual_fingers=True, axes=EACH),
            "0D 04 00 01 02 03 04 05 06 07 08 09 0A 0B 0C",
        ),
    ],
)
def test_command_registers_match_the_manual(command: Command, written: str) -> None:
    assert pack_command(command) == image(written)


def test_status_of_a_finished_grip_matches_the_manual() -> None:
    status = unpack_status(image("B9 EA 00 FF BC 00 00 C1 00 00 BD 00 00 89 00 00"))
    assert (status.ready, status.go_to, status.motion) == (True, True, MotionStatus.ALL_STOPPED_EARLY)
    assert [axis.status for axis in status.axes[:3]] == [ObjectStatus.CONTACT_CLOSING] * 3
    assert status.axis("S").status is ObjectStatus.AT_REQUEST
    assert status.axis("A").requested == 0xFF
    assert [status.axis(name).position for name in AXES] == [0xBC, 0xC1, 0xBD, 0x89]
    assert status.fault == 0


@pytest.mark.parametrize(
    ("read", "stage", "motion", "ready"),
    [
        ("11 00", Stage.ACTIVATING, MotionStatus.MOVING, False),
        ("31 00", Stage.READY, MotionStatus.MOVING, True),
        ("39 C0 00 FF 08 0F 00 08 10 00 08 0F 00 89 00 00", Stage.READY, MotionStatus.MOVING, True),
        ("F9 FF 00 00 07 00 00 06 00 00 06 00 00 89 00 00", Stage.READY, MotionStatus.AT_REQUEST, True),
    ],
)
def test_status_registers_match_the_manual(
    read: str, stage: Stage, motion: MotionStatus, ready: bool
) -> None:
    status = unpack_status(image(read))
    assert (status.stage, status.motion, status.ready) == (stage, motion, ready)
    assert pack_status(status) == image(read)


@given(statuses)
def test_every_status_is_unchanged_after_packing_and_parsing(status: Status) -> None:
    assert unpack_status(pack_status(status)) == status


def test_invalid_register_images_and_counts_are_rejected() -> None:
    for registers in ([], [0] * 7, [0] * 9, [0x10000] * 8, [-1] * 8):
        with pytest.raises(DeviceError, match="preset"):
            unpack_status(registers)
    for position in (-1, 256, 100.0, None):
        with pytest.raises(OutOfLimitsError, match="0 to 255"):
            pack_command(whole_hand(position))  # type: ignore[arg-type]


def test_fault_codes_have_a_meaning_and_a_remedy() -> None:
    assert "0x0D, activation failed; free the fingers" in fault_code_text(0x0D)
    assert "0x42, which is not in the manual" in fault_code_text(0x42)


def test_force_and_speed_are_limited_to_the_range_of_the_gripper() -> None:
    assert (force_counts(15.0), force_counts(60.0)) == (0, 255)
    assert (speed_counts(0.022), speed_counts(0.110)) == (0, 255)
    for force in (1.8, 14.9, 61.0, float("nan")):
        with pytest.raises(OutOfLimitsError, match="one-count steps"):
            force_counts(force)
    for speed in (0.0, 0.2, float("nan")):
        with pytest.raises(OutOfLimitsError, match="speed"):
            speed_counts(speed)
