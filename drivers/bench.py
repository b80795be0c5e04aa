"""The bench: its devices in one value, connected and let go in order."""

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
    """Stands for a device that a bench lacks: whatever is asked of it raises `InputError`."""

    def __init__(self, section: str) -> None:
        self._section = section

    def __getattr__(self, name: str) -> Any:
        """Raise `InputError`."""
        raise InputError(f"this bench has no [{self._section}]: add it to the bench file")


def missing_device(section: Literal["arm", "gripper", "camera"]) -> Any:
    """Return what stands for a device that a bench lacks, in the place of the device."""
    return MissingDevice(section)


@dataclass(frozen=True, slots=True)
class Fingertip:
    """A tactile sensor on a grasping finger.

    `sign` (+1 or -1) turns the sensor's image angle into the object's angle as the external
    camera sees it: the two fingers look at the object from opposite sides.
    """

    sensor: TactileSensor
    finger: str
    sign: int


class Hand:
    """What is known of the hand of a bench: whoever moves it says so here, before it becomes so.

    keep: is given each change, where it outlives this program.
    """

    def __init__(
        self, state: HandState = NOT_LOOKED_AT, keep: Callable[[HandState], None] = lambda state: None
    ) -> None:
        self._state, self._keep = state, keep

    @property
    def state(self) -> HandState:
        """What is known."""
        return self._state

    def note(self, state: HandState) -> None:
        """Know something else from now on."""
        if state != self._state:
            self._state = state
            self._keep(state)


@dataclass(frozen=True, slots=True)
class Bench:
    """All devices of one bench; a `MissingDevice` stands for one that it lacks.

    `base_T_camera` places the external camera (x right, y down, z forward) in the arm's base.
    `base_T_table` is where an operator places objects: its origin is the object's centre of
    mass when placed, x along the object, z up from the table top. `base_T_home` is where the TCP is
    while the arm waits. `hand`: what it is known to do.
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
        """What can move."""
        return tuple(device for device in (self.gripper, self.arm) if not isinstance(device, MissingDevice))

    def has(self, device: Literal["arm", "gripper", "camera"]) -> bool:
        """Whether the bench has this device."""
        return not isinstance(getattr(self, device), MissingDevice)

    @contextmanager
    def connected(self) -> Iterator["Bench"]:
        """Connect all devices, sensors before actuators, and let go in reverse order."""
        with ExitStack() as stack:
            for device in (*self.frame_sources, *self.actuators):
                stack.callback(device.disconnect)
                device.connect()
            yield self
