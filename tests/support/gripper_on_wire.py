"""A simulated gripper on the wire: its clock, its command registers, and waiting for errors and positions."""

from collections.abc import Callable

from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.robotiq_3f.gripper import Robotiq3F
from fakes.wire.gripper.server import GripperRtu, GripperServer
from support.finger_counts import counts_of
from support.waiting import until

Wire = GripperServer | GripperRtu


class HurriedClock(SystemClock):
    """World clock at several times real time, so that tests do not wait for fingers."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self._times = times

    def now_ns(self) -> int:
        return self._times * super().now_ns()


def written(fake: Wire) -> bytes:
    """Return the command registers of a gripper."""
    return bytes.fromhex(fake.snapshot()["written"])


def raised_by(call: Callable[[], object]) -> DeviceError:
    """Repeat a call until it raises, and return the error. The benchmark measures the delay."""
    errors: list[DeviceError] = []

    def raises() -> bool:
        try:
            call()
        except DeviceError as error:
            errors.append(error)
        return bool(errors)

    until(raises)
    return errors[0]


def reach(gripper: Robotiq3F, counts: int) -> None:
    """Wait until the fingers have passed a position."""
    until(lambda: counts_of(gripper) > counts)
