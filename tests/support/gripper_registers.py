"""A gripper's status packed into its registers, which the driver only reads."""

from drivers.robotiq_3f.registers import Status


def pack_status(status: Status) -> tuple[int, ...]:
    """Return the 8 registers of a status, the inverse of `unpack_status`."""
    gripper = status.activated | status.mode << 1 | status.go_to << 3
    gripper |= status.stage << 4 | status.motion << 6
    objects = sum(axis.status << 2 * number for number, axis in enumerate(status.axes))
    axes = [value for axis in status.axes for value in (axis.requested, axis.position, axis.current)]
    data = [gripper, objects, status.fault, *axes, 0]
    return tuple(high << 8 | low for high, low in zip(data[::2], data[1::2], strict=True))
