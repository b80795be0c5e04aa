"""The device interfaces of the bench: arm, gripper, tactile sensor and camera.

Drivers name these protocols as base classes, so that a search finds them and a type checker reports missing
members. Methods with a verb act; nouns only read. Motions return immediately with a handle.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from drivers.errors import DeviceError
from drivers.motion import Motion
from drivers.types import ArmLimits, ArmState, Frame, GripperSpec, GripperState, Pose


class Device(Protocol):
    """A device: its connection, and diagnostics, which by default are not supported and return no data."""

    def connect(self) -> None:
        """Connect to the device without moving anything; a source of frames starts capturing."""

    def disconnect(self) -> None:
        """Stop any motion or capturing, and close the connection. Safe to call twice."""

    def identity(self) -> Mapping[str, str]:
        """Return model, serial number, firmware and the like by name, as far as they are known."""
        return {}

    def counters(self) -> Mapping[str, int]:
        """Return event counts since the driver was created or connected, by name."""
        return {}

    def round_trips_s(self) -> Sequence[float]:
        """Return the durations of the newest answered requests, s."""
        return ()

    def clock_offset_s(self) -> float | None:
        """Return the device's time minus this computer's monotonic time, s; None without a device clock."""
        return None


class Arm(Device, Protocol):
    """A six-axis arm with a tool centre point. Poses are `base_T_tcp`, m and rad."""

    limits: ArmLimits
    """The limits that motions are checked against."""

    def state(self) -> ArmState:
        """Return the newest state. Raises `DeviceError` if it is stale or the connection is lost."""
        ...

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Start a straight motion and return immediately.

        Raises `OutOfLimitsError` before anything is sent, `ProtectiveStopError` if the arm is stopped.
        """
        ...

    def stop(self) -> None:
        """Stop as fast as the arm can. Callable from any thread at any time; raises no error."""

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand (freedrive), until `end_guiding` or `stop`.

        The arm compensates the weight of the configured tool and payload only. If the program stops polling
        `state`, guiding ends and the arm holds its position; `state` then raises `DeviceError` until
        `end_guiding`. Raises `DeviceError` if the arm does not support guiding.
        """
        raise DeviceError("arm: its driver does not support guiding by hand; teach with --by keys")

    def end_guiding(self) -> None:
        """Hold the arm where it is, in position control, and return when it stands. Safe to call at any time.

        Raises `DeviceError` if the arm may still be moving.
        """

    def speed_fraction(self) -> float | None:
        """Return the speed fraction at which motions would run, see `ArmState`; also before `connect`.

        Only reads. Raises `DeviceError` if the arm cannot be reached.
        """
        return None

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop after a person who has inspected the arm agrees; nothing moves.

        confirm: asks that person a question, and raises unless they agree. Does nothing if the arm is
        running. Raises `DeviceError` if the arm cannot be set running.
        """


class Gripper(Device, Protocol):
    """Two grasping fingers: opening between the fingertips in m, speed in m/s, force in N."""

    spec: GripperSpec
    """Range and resolution of the fingers, range of speed and force."""

    def activate(self) -> None:
        """Run the activation sequence: the fingers sweep their range. Only on explicit request."""

    def state(self) -> GripperState:
        """Return the newest state. Raises `DeviceError` if the gripper is disconnected or in fault."""
        ...

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the fingers to the position nearest to an opening, and return immediately.

        speed_m_s, force_n: the gripper's defaults if None. Raises `OutOfLimitsError` before anything is
        sent, see `GripperSpec.require_command`.
        """
        ...

    def stop(self) -> None:
        """Hold the fingers where they are."""

    def keep_grip(self, most_m: float) -> None:
        """Keep the grip of the last motion until the next command (`move_to`, `stop`, `activate`).

        If the fingers open beyond `most_m` although no command was given, the driver's own loop closes them
        again at once, with the position, speed and force of that motion, and every later state has
        `reclosed_from_m`. This is the only motion that a driver may start without a call. It is not started
        if the gripper has a fault, is not activated, or has received a command from another program. The
        opening is read at least every 20 ms. Returns at once; after a stop there is no grip to keep, and
        nothing happens. Not supported by default: `protocols.pump` then stops fingers that open.
        """


class FrameSource(Device, Protocol):
    """A device that captures frames; frames that are not read in time are counted as dropped."""

    serial: str
    """Serial number, the same after each reconnect."""
    rate_hz: float
    """Requested frame rate."""
    waits: bool = False
    """Whether frames wait until they are read, so that none is dropped. Only a file can do this."""

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the oldest frame that was not read yet; wait if there is none. Raises `DeviceTimeoutError`.

        A source keeps a short backlog, so a reader that is a few frames late loses none. If the backlog is
        full, the oldest frame is dropped, which leaves a gap in `Frame.sequence`.
        """
        ...

    def newest_frame(self, max_age_s: float) -> Frame:
        """Return the newest frame and discard the backlog. Raises `StaleFrameError` if it is too old."""
        ...


class TactileSensor(FrameSource, Protocol):
    """A DIGIT-like fingertip camera under a lit gel."""

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1."""


class Camera(FrameSource, Protocol):
    """The external camera that sees the markers."""
