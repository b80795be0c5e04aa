"""The bench: all its devices in one value, connected and disconnected in order."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

from drivers.clock import Clock
from drivers.errors import InputError
from drivers.interfaces import Arm, Camera, FrameSource, Gripper, TactileSensor
from drivers.types import HandState, Holding, Pose

NOT_LOOKED_AT = HandState(Holding.UNKNOWN, "not looked at yet")


class MissingDevice:
    """Placeholder for a device that a bench lacks: any use of it raises `InputError`."""

    def __init__(self, section: str) -> None:
        self._section = section

    def __getattr__(self, name: str) -> Any:
        """Raise `InputError`."""
        raise InputError(f"this bench has no [{self._section}]: add it to the bench file")


def missing_device(section: Literal["arm", "gripper", "camera"]) -> Any:
    """Return the placeholder for a device that a bench lacks; its type checks as any device."""
    return MissingDevice(section)


@dataclass(frozen=True, slots=True)
class Fingertip:
    """A tactile sensor on a grasping finger.

    `sign` (+1 or -1) converts the sensor's image angle to the object's angle as the external camera sees
    it: the two fingers see the object from opposite sides.
    """

    sensor: TactileSensor
    finger: str
    sign: int


class Hand:
    """The known state of the hand. Code that moves the hand updates it here before the state changes.

    keep: called with each new state, to store it beyond the end of this program.
    """

    def __init__(
        self, state: HandState = NOT_LOOKED_AT, keep: Callable[[HandState], None] = lambda state: None
    ) -> None:
        self._state, self._keep = state, keep

    @property
    def state(self) -> HandState:
        return self._state

    def note(self, state: HandState) -> None:
        if state != self._state:
            self._state = state
            self._keep(state)


@dataclass(frozen=True, slots=True)
class Bench:
    """All devices of one bench; a `MissingDevice` stands in for each device that it lacks.

    `base_T_camera` is the pose of the external camera (x right, y down, z forward) in the arm's base frame.
    `base_T_table` is the pose at which an operator places objects: its origin is the placed object's centre
    of mass, x points along the object, z up from the table top. `base_T_home` is the TCP pose in which the
    arm waits. `hand` is the known state of the hand.
    """

    name: str
    simulated: bool
    clock: Clock
    arm: Arm
    gripper: Gripper
    fingertips: tuple[Fingertip, ...]
    camera: Camera
    base_T_camera: Pose  # noqa: N815 - frame names keep their case
    base_T_table: Pose  # noqa: N815
    base_T_home: Pose  # noqa: N815
    hand: Hand = field(default_factory=Hand)

    @property
    def frame_sources(self) -> tuple[FrameSource, ...]:
        """Every source of frames: fingertips first, then the camera."""
        camera = (self.camera,) if self.has("camera") else ()
        return (*(tip.sensor for tip in self.fingertips), *camera)

    @property
    def actuators(self) -> tuple[Gripper | Arm, ...]:
        """The devices that can move: gripper and arm, as far as the bench has them."""
        return tuple(device for device in (self.gripper, self.arm) if not isinstance(device, MissingDevice))

    def has(self, device: Literal["arm", "gripper", "camera"]) -> bool:
        return not isinstance(getattr(self, device), MissingDevice)

    @contextmanager
    def connection(self) -> Iterator["Bench"]:
        """Connect all devices, sensors before actuators; disconnect in reverse order at the end."""
        with ExitStack() as stack:
            for device in (*self.frame_sources, *self.actuators):
                stack.callback(device.disconnect)
                device.connect()
            yield self
