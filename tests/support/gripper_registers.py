"""What the driver has no use for: the registers of a command read back, a status packed into them."""

from collections.abc import Sequence
from itertools import chain

from drivers.robotiq_3f.registers import AxisRequest, Command, GraspMode, Status


def unpack_command(registers: Sequence[int]) -> Command:
    """Read a command image back, the inverse of `pack_command`."""
    data = list(chain.from_iterable(divmod(register, 256) for register in registers))
    return Command(
        activate=bool(data[0] & 1),
        mode=GraspMode(data[0] >> 1 & 3),
        go_to=bool(data[0] >> 3 & 1),
        release=bool(data[0] >> 4 & 1),
        glove=bool(data[1] & 1),
        individual_fingers=bool(data[1] >> 2 & 1),
        individual_scissor=bool(data[1] >> 3 & 1),
        axes=tuple(AxisRequest(*data[start : start + 3]) for start in (3, 6, 9, 12)),
    )


def pack_status(status: Status) -> tuple[int, ...]:
    """Return the 8 registers of a status, the inverse of `unpack_status`."""
    gripper = status.activated | status.mode << 1 | status.go_to << 3
    gripper |= status.stage << 4 | status.motion << 6
    objects = sum(axis.status << 2 * number for number, axis in enumerate(status.axes))
    axes = [value for axis in status.axes for value in (axis.requested, axis.position, axis.current)]
    data = [gripper, objects, status.fault, *axes, 0]
    return tuple(high << 8 | low for high, low in zip(data[::2], data[1::2], strict=True))
