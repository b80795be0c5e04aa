"""The status of the arm's controller as modes and errors; its notation of poses.

The controller writes a pose as x y z in m and a rotation vector in rad; `to_ur` and `from_ur` convert.
Status values and bits: Universal Robots, "RTDE Guide", robot_mode, runtime_state, safety_status_bits.
"""

import math

from scipy.spatial.transform import Rotation

from drivers.errors import DeviceError, ProtectiveStopError
from drivers.types import ArmMode, Pose, Vector6
from drivers.ur5e.shared_state import StateSample

PLAYING = 2
"""Runtime state of a running program (RTDE guide)."""
RUNNING_MODE = 7
"""Robot mode of an arm that is powered on with its brakes released (RTDE guide)."""
NORMAL, REDUCED, PROTECTIVE, RECOVERY, SAFEGUARD = (1 << bit for bit in range(5))
EMERGENCY = 1 << 5 | 1 << 6 | 1 << 7
VIOLATION, FAULT, STOPPED_FOR_SAFETY = 1 << 8, 1 << 9, 1 << 10
_ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes on",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}
_RUNTIME = {0: "stopping", 1: "stopped", 2: "playing", 3: "pausing", 4: "paused", 5: "resuming"}
_SAFETY = (
    (VIOLATION, "safety violation", "see the pendant"),
    (FAULT, "safety fault", "see the pendant; restart the safety system there"),
    (RECOVERY, "recovery mode", "move the arm back into its limits on the pendant"),
    (SAFEGUARD, "safeguard stop", "close the safeguard and reset it"),
    (STOPPED_FOR_SAFETY, "stopped for safety", "see the pendant"),
)


def arm_mode(sample: StateSample) -> ArmMode:
    """Return the safety state; if several bits are set, the most serious one."""
    if sample.safety_bits & EMERGENCY:
        return ArmMode.EMERGENCY_STOP
    if sample.safety_bits & PROTECTIVE:
        return ArmMode.PROTECTIVE_STOP
    if not sample.safety_bits & (NORMAL | REDUCED) or sample.robot_mode != RUNNING_MODE:
        return ArmMode.UNKNOWN
    return ArmMode.RUNNING


def stop_reason(sample: StateSample) -> DeviceError | None:
    """Return why the arm cannot move, as an error to raise; None if it can."""
    bits = sample.safety_bits
    if bits & EMERGENCY:
        return DeviceError(
            f"arm: emergency stop (safety bits {bits:#x}); clear the danger, turn the button out, "
            "switch the arm on and release its brakes on the pendant, then connect again"
        )
    if bits & PROTECTIVE:
        return ProtectiveStopError(
            f"arm: protective stop (safety bits {bits:#x}); inspect the arm, clear the cause, release it"
        )
    for bit, what, remedy in _SAFETY:
        if bits & bit:
            return DeviceError(f"arm: {what} (safety bits {bits:#x}); {remedy}")
    if sample.robot_mode != RUNNING_MODE:
        mode = _ROBOT_MODES.get(sample.robot_mode, f"mode {sample.robot_mode}")
        return DeviceError(
            f"arm: {mode}; switch it on and release its brakes on the pendant, then connect again"
        )
    if not bits & (NORMAL | REDUCED):
        return DeviceError(
            f"arm: its safety system is in neither normal nor reduced mode (bits {bits:#x}); see the pendant"
        )
    return None


def program_reason(sample: StateSample) -> DeviceError | None:
    """Return why commands are not executed: a `stop_reason`, or the control program does not run."""
    reason = stop_reason(sample)
    if reason is None and sample.runtime_state != PLAYING:
        state = _RUNTIME.get(sample.runtime_state, f"state {sample.runtime_state}")
        reason = DeviceError(
            f"arm: its control program is {state}; it was ended on the pendant, by an error shown there, "
            "or because the connection was too slow. Inspect the arm, then start again"
        )
    return reason


_TURN = 2 * math.pi
JOINT_RANGE_RAD: tuple[Vector6, Vector6] = (
    (-_TURN, -_TURN, -_TURN, -_TURN, -_TURN, -_TURN),
    (_TURN, _TURN, _TURN, _TURN, _TURN, _TURN),
)
"""Working range of a UR5e's joints: +-360 degrees (data sheet)."""
STILL_M_S, STILL_RAD_S = 0.002, 0.01
"""Speeds of the TCP below which the arm counts as standing."""


def to_ur(pose: Pose) -> Vector6:
    """Convert a pose to the controller's notation: x y z in m, rotation vector in rad."""
    x, y, z = pose.position_m
    rx, ry, rz = (float(v) for v in pose.rotation.as_rotvec())
    return x, y, z, rx, ry, rz


def from_ur(values: Vector6) -> Pose:
    return Pose.from_rotation((values[0], values[1], values[2]), Rotation.from_rotvec(values[3:]))


def is_still(sample: StateSample) -> bool:
    return math.hypot(*sample.speed[:3]) < STILL_M_S and math.hypot(*sample.speed[3:]) < STILL_RAD_S
