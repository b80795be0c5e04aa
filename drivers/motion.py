"""Motions of any device: limit checks before a motion is sent, and waiting for its end."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import TypeVar

from drivers.clock import Clock, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, OutOfLimitsError
from drivers.types import ArmLimits, Box, Pose, Vector3, Vector6

UPRIGHT_M = 1e-3
"""A path counts as vertical if its ends are at most this far apart horizontally, m."""
POLL_S = 0.008
"""Polling interval of a motion; `drivers.ur5e.heartbeat` needs a poll at least every 15 ms."""
Joints = TypeVar("Joints", bound=Sequence[float])


def check_motion(
    limits: ArmLimits, start: Pose, target: Pose, speed_m_s: float, acceleration_m_s2: float
) -> None:
    """Raise `OutOfLimitsError` for a straight motion that no arm may begin.

    Its target, speed or acceleration is outside the limits or not a number, or it crosses a keep-out box.
    """
    if not limits.has_inside(target.position_m):
        low, high = limits.workspace_min_m, limits.workspace_max_m
        raise OutOfLimitsError(f"arm: target {target.position_m} m leaves the workspace {low} to {high} m")
    if not all(map(math.isfinite, target.quaternion_xyzw)):
        raise OutOfLimitsError(f"arm: target {target} is not a valid pose")
    for what, value, most, unit in (
        ("speed", speed_m_s, limits.max_speed_m_s, "m/s"),
        ("acceleration", acceleration_m_s2, limits.max_acceleration_m_s2, "m/s2"),
    ):
        if not 0.0 < value <= most:
            raise OutOfLimitsError(f"arm: {what} {value} {unit} is outside 0 to {most} {unit}")
    check_way(limits, (start, target))


def check_way(limits: ArmLimits, way: Sequence[Pose]) -> None:
    """Raise `OutOfLimitsError` if a path of straight segments crosses a keep-out box of `limits`.

    From inside a box, only a segment straight up is permitted.
    """
    for here, there in pairwise(pose.position_m for pose in way):
        across = max(abs(here[0] - there[0]), abs(here[1] - there[1]))
        straight_up = across <= UPRIGHT_M and there[2] > here[2]
        for box in limits.keep_out:
            inside = all(low < v < high for low, v, high in zip(box.min_m, here, box.max_m, strict=True))
            if meets(box, here, there) and not (inside and straight_up):
                raise OutOfLimitsError(
                    f"arm: the path from {position_text(here)} to {position_text(there)} m leads the hand "
                    f"into '{box.name}', which the bench file keeps it out of; see [[keep_out]], top_m of "
                    "[table], and the position of the object"
                )


def check_joints(joints: Joints | None, limits: tuple[Vector6, Vector6], target: Pose) -> Joints:
    """Return the joint angles (rad) that reach a target.

    Raises `OutOfLimitsError` if there are none (None), or one is outside its range.
    """
    if not joints:
        raise OutOfLimitsError(f"arm: pose {target} is out of reach or outside the safety limits")
    for number, (angle, low, high) in enumerate(zip(joints, *limits, strict=True), 1):
        if not low <= angle <= high:
            raise OutOfLimitsError(
                f"arm: joint {number} would go to {math.degrees(angle):.1f} deg, outside "
                f"{math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
            )
    return joints


def meets(box: Box, here: Vector3, there: Vector3) -> bool:
    """Whether the straight line between two points passes through the interior of a box."""
    enters, leaves = 0.0, 1.0
    for a, b, low, high in zip(here, there, box.min_m, box.max_m, strict=True):
        if a == b:
            if not low < a < high:
                return False
            continue
        first, last = sorted(((low - a) / (b - a), (high - a) / (b - a)))
        enters, leaves = max(enters, first), min(leaves, last)
    return enters < leaves


def position_text(point: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in point) + ")"


class Motion:
    """A motion in progress, real or simulated.

    device: name for messages. ended: returns whether the device has ended the motion, and raises its error
    if it failed; it is polled every `POLL_S`. stop: stops the device.
    """

    def __init__(
        self, device: str, clock: Clock, ended: Callable[[], bool], stop: Callable[[], None]
    ) -> None:
        self._device, self._clock, self._ended, self._stop = device, clock, ended, stop

    def is_done(self) -> bool:
        """Whether the motion has ended. Raises the device's error if the motion failed."""
        return self._ended()

    def wait(self, timeout_s: float) -> None:
        """Block until done. Raises `DeviceTimeoutError` after `timeout_s`, and any error of `is_done`.

        If the wait ends early, also by an interrupt, the motion is stopped.
        """
        try:
            if not wait_until(self._clock, self.is_done, timeout_s, POLL_S):
                raise DeviceTimeoutError(
                    f"{self._device}: motion not finished after {timeout_s:.1f} s; stopped it"
                )
        except BaseException:  # also an interrupt: a motion that nobody supervises must not continue
            with suppress(DeviceError):  # the first error is more informative
                self._stop()
            raise
