"""The vocabulary of the bench: what an arm, a gripper, a tactile sensor and a camera can do.

Implementations name these protocols as bases, so they can be found by search and a type
checker reports a missing member. Verbs act, nouns read. Motions return at once with a handle.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from drivers.errors import DeviceError
from drivers.types import ArmLimits, ArmState, Frame, GripperSpec, GripperState, Pose


class Motion(Protocol):
    """A motion in progress."""

    def done(self) -> bool:
        """Whether the motion has ended. Raises the device's error when it ended badly."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Block until done. Raises `DeviceTimeoutError` after `timeout_s`, and what `done` raises.

        A wait that ends early, also by an interruption, stops the motion.
        """
        ...


class Diagnosable(Protocol):
    """What a device says of itself and its connection; nothing, as here, where it cannot tell."""

    def identity(self) -> Mapping[str, str]:
        """Model, serial number, firmware and the like by name, as far as they are known."""
        return {}

    def counters(self) -> Mapping[str, int]:
        """How often something happened since the driver was made or connected, by name."""
        return {}

    def round_trips_s(self) -> Sequence[float]:
        """Durations of the newest answered requests, s."""
        return ()

    def clock_offset_s(self) -> float | None:
        """The device's time minus this computer's monotonic time, s; None where it tells no time."""
        return None


class Arm(Diagnosable, Protocol):
    """A six-axis arm with a tool centre point. Poses are `base_T_tcp`, m and rad."""

    @property
    def limits(self) -> ArmLimits:
        """What this arm refuses to exceed."""
        ...

    def connect(self) -> None:
        """Reach the arm without moving it."""
        ...

    def disconnect(self) -> None:
        """Stop any motion and let go of the connection. Safe to call twice."""
        ...

    def state(self) -> ArmState:
        """Newest state. Raises `DeviceError` when it is stale or the arm is gone."""
        ...

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Start a straight motion and return at once.

        Raises `OutOfLimitsError` before anything is sent, `ProtectiveStopError` when stopped.
        """
        ...

    def stop(self) -> None:
        """Stop as fast as the arm can, from any thread, at any time, without an error."""
        ...

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand (freedrive), until `end_guiding` or `stop`.

        It carries the tool and payload that it was told of, and nothing else. Ends by itself, the arm
        standing, where nobody asks for `state` any more; `state` then raises `DeviceError` until
        `end_guiding`. Raises `DeviceError` where the arm cannot do that.
        """
        raise DeviceError("arm: its driver does not let it be led by hand; teach with --by keys")

    def end_guiding(self) -> None:
        """Hold the arm where it is, in position control, and return when it stands. Safe to call at any time.

        Raises `DeviceError` where that is not certain.
        """

    def speed_fraction(self) -> float | None:
        """At which share of their speed motions would run, as `ArmState` has it; also before `connect`.

        The arm is looked at, no more. Raises `DeviceError` where it cannot be reached.
        """
        return None

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop, once a person who has looked at the arm agrees; nothing moves.

        confirm: puts a question to that person and raises unless they agree. Does nothing
        when the arm is running; raises `DeviceError` when it cannot be made to run.
        """
        ...


class Gripper(Diagnosable, Protocol):
    """Two grasping fingers: opening between the fingertips in m, speed in m/s, force in N."""

    @property
    def spec(self) -> GripperSpec:
        """Range and resolution of the fingers, range of speed and force."""
        ...

    def connect(self) -> None:
        """Reach the gripper without moving it."""
        ...

    def disconnect(self) -> None:
        """Stop any motion and let go of the connection. Safe to call twice."""
        ...

    def activate(self) -> None:
        """Run the activation sequence: the fingers sweep their range. Only ever on request."""
        ...

    def state(self) -> GripperState:
        """Newest state. Raises `DeviceError` when the gripper is gone or in fault."""
        ...

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the fingers to the position nearest to an opening and return at once.

        speed_m_s, force_n: the gripper's own defaults if None. Raises `OutOfLimitsError` before anything is
        sent, see `GripperSpec.require_command`.
        """
        ...

    def stop(self) -> None:
        """Hold the fingers where they are."""
        ...


class FrameSource(Diagnosable, Protocol):
    """Something that captures frames; frames not read in time are counted as dropped."""

    @property
    def serial(self) -> str:
        """Serial number, stable over reconnects."""
        ...

    @property
    def rate_hz(self) -> float:
        """Requested frame rate."""
        ...

    def connect(self) -> None:
        """Start capturing."""
        ...

    def disconnect(self) -> None:
        """Stop capturing. Safe to call twice."""
        ...

    def next_frame(self, timeout_s: float) -> Frame:
        """Oldest frame not read yet; waits for one. Raises `DeviceTimeoutError`.

        A source keeps a short backlog, so a reader that is late by a few frames loses none;
        beyond that the oldest go, and the gap shows in `Frame.sequence`.
        """
        ...

    def newest_frame(self, max_age_s: float) -> Frame:
        """Newest frame; skips the backlog. Raises `StaleFrameError` when it is older."""
        ...


class TactileSensor(FrameSource, Protocol):
    """A DIGIT-like fingertip camera under a lit gel."""

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1."""
        ...


class Camera(FrameSource, Protocol):
    """The external camera that sees the markers."""
