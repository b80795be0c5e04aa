"""Guards in front of drivers of a lab's own: limits, typed errors, valid values.

A guard forwards each call. It rejects a motion beyond the bench file's limits before the driver is called,
turns any other exception of the driver into a `DeviceError` that names it, and rejects invalid answers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.clock import Clock
from drivers.errors import DamagedFrameError, InvalidStateError, OutOfLimitsError
from drivers.interfaces import Arm, Gripper, Motion, TactileSensor
from drivers.keep_out import check_way
from drivers.state_values import require_fraction, require_integer
from drivers.types import ArmLimits, ArmState, Frame, GripperLimits, GripperState, Pose
from drivers.ur5e.limits import check_motion
from rig.bench.guard import Guard, GuardedMotion, StateGuard, amiss, answer, doing

ARM_STALE_S, GRIPPER_STALE_S = 0.4, 0.9
"""Largest age of a state, as in the rig's own drivers (`drivers.ur5e.link`, `drivers.robotiq_3f.poller`)."""


class GuardedArm(StateGuard, Arm):
    """An arm of somebody's own, within the bench file's limits."""

    def __init__(self, driver: Any, named: str, limits: ArmLimits, clock: Clock) -> None:
        super().__init__("arm", driver, named, clock)
        self._limits = limits

    @property
    def limits(self) -> ArmLimits:
        """The bench file's limits, whatever the driver's own are."""
        return self._limits

    def state(self) -> ArmState:
        """Newest state. Raises `DeviceError`."""
        with doing(self._whose, "state"):
            state = answer(self._whose, "state", self._driver.state(), ArmState)
        self.require_current(state.time_ns, ARM_STALE_S)
        self._require_wrench_as_declared(state)
        return state

    def _require_wrench_as_declared(self, state: ArmState) -> None:
        has_sensor = self._limits.max_contact_force_n is not None
        if has_sensor and state.wrench is None:
            raise InvalidStateError(
                f"{self._whose}: its state has no wrench, so that nothing would stop it on its way down; "
                "return the wrench, or write force_sensor = false in [arm] of the bench file"
            )
        if not has_sensor and state.wrench is not None:
            raise InvalidStateError(
                f"{self._whose}: its state has a wrench, and the bench file says force_sensor = false; "
                "remove that key, or return None as wrench"
            )

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Start a straight motion. Raises `OutOfLimitsError` before the driver hears of it."""
        check_motion(self._limits, base_T_tcp, speed_m_s, acceleration_m_s2)
        check_way(self._limits, (self.state().base_T_tcp, base_T_tcp))
        with doing(self._whose, "move_linear"):
            motion = self._driver.move_linear(base_T_tcp, speed_m_s, acceleration_m_s2)
        return GuardedMotion(motion, f"{self._whose}: move_linear", self.stop)

    def stop(self) -> None:
        """Stop as fast as the arm can."""
        self._stop()

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand. Raises `DeviceError` if the driver cannot do that."""
        begin = getattr(self._driver, "begin_guiding", super().begin_guiding)
        with doing(self._whose, "begin_guiding"):
            begin()

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands."""
        end = getattr(self._driver, "end_guiding", super().end_guiding)
        with doing(self._whose, "end_guiding"):
            end()

    def speed_fraction(self) -> float | None:
        """At which share of their speed motions would run, None if unknown. Raises `DeviceError`."""
        with doing(self._whose, "speed_fraction"):
            fraction = self._told("speed_fraction", None)
            if fraction is not None:
                require_fraction("the arm's speed_fraction", fraction)
        return fraction

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop, once a person agrees."""
        with doing(self._whose, "recover"):
            self._driver.recover(confirm)


class GuardedGripper(StateGuard, Gripper):
    """A gripper of somebody's own, within the bench file's limits."""

    def __init__(self, driver: Any, named: str, limits: GripperLimits, clock: Clock) -> None:
        super().__init__("gripper", driver, named, clock)
        self._limits = limits

    @property
    def limits(self) -> GripperLimits:
        """The bench file's limits, whatever the driver's own are."""
        return self._limits

    def activate(self) -> None:
        """Run the activation sequence, on request only."""
        with doing(self._whose, "activate"):
            self._driver.activate()

    def state(self) -> GripperState:
        """Newest state. Raises `DeviceError`, also for a position that the bench file's range excludes."""
        with doing(self._whose, "state"):
            state = answer(self._whose, "state", self._driver.state(), GripperState)
            self._limits.require_possible(state.position_counts)
        self.require_current(state.time_ns, GRIPPER_STALE_S)
        return state

    def move_to(self, position_counts: int) -> Motion:
        """Start moving the fingers. Raises `OutOfLimitsError` before the driver hears of it."""
        low, high = self._limits.min_counts, self._limits.max_counts
        if not low <= position_counts <= high:
            raise OutOfLimitsError(f"gripper: {position_counts} counts is outside {low} to {high}")
        with doing(self._whose, "move_to"):
            motion = self._driver.move_to(position_counts)
        return GuardedMotion(motion, f"{self._whose}: move_to", self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are."""
        self._stop()


class GuardedSource(Guard, TactileSensor):
    """A tactile sensor or a camera of somebody's own. size_px: width and height that its frames have."""

    def __init__(
        self, driver: Any, named: str, serial: str, rate_hz: float, size_px: tuple[int, int]
    ) -> None:
        super().__init__(serial, driver, named)
        self._serial, self._rate_hz, self._shape = serial, rate_hz, (size_px[1], size_px[0], 3)

    @property
    def serial(self) -> str:
        """Serial number, as the bench file says."""
        return self._serial

    @property
    def rate_hz(self) -> float:
        """Requested frame rate, as the bench file says."""
        return self._rate_hz

    def next_frame(self, timeout_s: float) -> Frame:
        """Oldest frame not read yet; waits for one. Raises `DeviceError`."""
        with doing(self._whose, "next_frame"):
            frame = self._driver.next_frame(timeout_s)
        return self._checked("next_frame", frame)

    def newest_frame(self, max_age_s: float) -> Frame:
        """Newest frame. Raises `DeviceError`."""
        with doing(self._whose, "newest_frame"):
            frame = self._driver.newest_frame(max_age_s)
        return self._checked("newest_frame", frame)

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1, where the driver can."""
        light = getattr(self._driver, "set_light", None)
        if light is not None:
            with doing(self._whose, "set_light"):
                light(red, green, blue)

    def _checked(self, what: str, given: object) -> Frame:
        frame = answer(self._whose, what, given, Frame)
        answer(self._whose, f"{what}: image", frame.image, np.ndarray)
        with doing(self._whose, what):
            require_integer("the frame's time_ns", frame.time_ns)
            require_integer("the frame's sequence", frame.sequence)
        if frame.image.dtype != np.uint8 or frame.image.shape != self._shape:
            raise DamagedFrameError(
                f"{self._whose}: a frame is {frame.image.dtype} {frame.image.shape}, and size_px asks for "
                f"uint8 {self._shape}; correct size_px in the bench file, or the driver"
            )
        if frame.serial != self._serial:
            raise amiss(self._whose, f"{what}: a frame of '{frame.serial}'")
        return frame
