"""A simulated UR5e: straight motions with trapezoidal speed, limits and protective stops."""

import math
from collections.abc import Callable

from drivers.clock import Clock, wait_until
from drivers.errors import (
    DeviceError,
    NotConnectedError,
    OutOfLimitsError,
    ProtectiveStopError,
)
from drivers.interfaces import Arm
from drivers.motion import PolledMotion, check_motion, check_way
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector6
from fakes.faults import FaultScript
from fakes.world import kinematics
from fakes.world.force_torque import FlangeSensor, carried_wrench, table_push_n
from fakes.world.motion import ToolPath, TrapezoidProfile, distance
from fakes.world.world import World

TOOL_LENGTH_M = 0.28
"""Flange to fingertips: 3-Finger gripper with DIGITs, nominal."""

STOP_DECELERATION_M_S2 = 10.0
"""As the driver of the real arm requests; a protective stop brakes at least as hard."""

LIMITS = ArmLimits(
    workspace_min_m=(0.15, -0.35, 0.01),
    workspace_max_m=(0.75, 0.35, 0.60),
    max_speed_m_s=0.5,
    max_acceleration_m_s2=1.5,
    max_payload_kg=5.0,
)


class FakeArm(Arm):
    """Moves the tool of the world; its joint angles follow from the UR5e's nominal kinematics.

    Reported joint angles have the noise of encoders, and the reported pose follows from them.

    joint_limits_rad: lowest and highest joint angles at the end of a motion; None for no check.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        faults: FaultScript,
        limits: ArmLimits = LIMITS,
        joint_limits_rad: tuple[Vector6, Vector6] | None = None,
    ) -> None:
        self._limits = limits
        self._joint_limits = joint_limits_rad
        self._world = world
        self._clock = clock
        self._faults = faults
        self._connected = False
        self._joints: Vector6 = kinematics.ELBOW_UP
        self._pose: Pose | None = None
        self._released = self._guided = False
        self._sensor, self._encoders = FlangeSensor(world.seed), kinematics.Encoders(world.seed)

    @property
    def limits(self) -> ArmLimits:
        """Limits that every motion is checked against."""
        return self._limits

    def connect(self) -> None:
        """Connect to the arm."""
        self._connected = True

    def disconnect(self) -> None:
        """Stop the motion and disconnect."""
        if self._connected:
            self.stop()
        self._connected = False

    def state(self) -> ArmState:
        """Return the current state."""
        self._require_connected()
        now = self._clock.now_ns()
        pose = self._world.tool.pose_at(now)
        if pose != self._pose:
            self._pose, self._joints = pose, self._reach(pose)
        stopped = self._protective_stop(now)
        joints = self._encoders.shown(self._joints, now)
        return ArmState(
            now,
            kinematics.forward(joints, TOOL_LENGTH_M),
            joints,
            None if self._limits.max_contact_force_n is None else self._feel(now),
            ArmMode.PROTECTIVE_STOP if stopped else ArmMode.RUNNING,
        )

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> PolledMotion:  # noqa: N803
        """Start a straight motion; see `drivers.interfaces.Arm`."""
        self._require_connected()
        check_motion(self._limits, base_T_tcp, speed_m_s, acceleration_m_s2)
        self._check_joints(self._reach(base_T_tcp))
        now = self._clock.now_ns()
        start = self._world.tool.pose_at(now)
        check_way(self._limits, (start, base_T_tcp))
        self._check_running()
        profile = TrapezoidProfile(now, distance(start, base_T_tcp), speed_m_s, acceleration_m_s2)
        self._world.tool = ToolPath.between(start, base_T_tcp, profile)
        return PolledMotion("arm", self._clock, self._arrived, self.stop)

    def begin_guiding(self) -> None:
        """Let the arm be led by hand, with `lead`."""
        self._require_connected()
        self._check_running()
        self._guided = True

    def end_guiding(self) -> None:
        """End leading by hand; the arm keeps its position."""
        if self._guided:
            self.stop()
            wait_until(
                self._clock, lambda: self._world.tool.profile.done_at(self._clock.now_ns()), 1.0, 0.004
            )

    def lead(self, to: Pose, over_s: float) -> None:
        """Lead the tool to a pose, as a person's hand would; it does nothing unless guiding is on."""
        now = self._clock.now_ns()
        start = self._world.tool.pose_at(now)
        way = max(distance(start, to), 1e-6)
        if self._guided:
            self._world.tool = ToolPath.between(
                start, to, TrapezoidProfile(now, way, 1.5 * way / over_s, 1e3)
            )

    def stop(self) -> None:
        """Brake any motion, and end guiding."""
        self._guided = False
        self._world.tool = self._world.tool.braked_at(self._clock.now_ns(), STOP_DECELERATION_M_S2)

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop after the operator has confirmed it."""
        self._require_connected()
        if self._protective_stop(self._clock.now_ns()):
            confirm("The arm is in protective stop. Is it free to move, and shall the stop be released?")
            self._released = True

    def _protective_stop(self, time_ns: int) -> bool:
        """Whether a protective stop is active: from the start of the fault until its end or its release."""
        active = self._faults.active("protective_stop", time_ns, "arm")
        self._released = self._released and active
        return active and not self._released

    def _arrived(self) -> bool:
        self._check_running()
        return self._world.tool.profile.done_at(self._clock.now_ns())

    def _check_running(self) -> None:
        """Stop and raise `ProtectiveStopError` or `DeviceError` if the arm cannot move."""
        now = self._clock.now_ns()
        if self._faults.active("disconnect", now, "arm"):
            self.stop()
            raise DeviceError("arm: connection lost; check the network, then start again")
        if self._protective_stop(now):
            self.stop()
            raise ProtectiveStopError(
                "arm: protective stop; check the arm, clear the cause, release the stop on the pendant"
            )

    def _require_connected(self) -> None:
        if not self._connected:
            raise NotConnectedError("arm: used before connect; connect the bench first")

    def _check_joints(self, joints_rad: Vector6) -> None:
        if self._joint_limits is None:
            return
        for number, (low, q, high) in enumerate(
            zip(self._joint_limits[0], joints_rad, self._joint_limits[1], strict=True), start=1
        ):
            if not low <= q <= high:
                raise OutOfLimitsError(
                    f"arm: joint {number} would end at {math.degrees(q):.1f} degrees, outside "
                    f"{math.degrees(low):.1f} to {math.degrees(high):.1f}"
                )

    def _reach(self, pose: Pose) -> Vector6:
        joints = kinematics.inverse(pose, TOOL_LENGTH_M, self._joints)
        joints = joints or kinematics.inverse(pose, TOOL_LENGTH_M)
        if joints is None:
            raise OutOfLimitsError(f"arm: pose {pose} is out of reach")
        return joints

    def _feel(self, time_ns: int) -> Vector6:
        """Return the measured force (N) and torque (N m) at the TCP in the base's axes."""
        tool = self._world.tool.position_at(time_ns)
        a, b, c, d, e, f = self._sensor.drifted(carried_wrench(self._world, time_ns), time_ns)
        push_n = table_push_n(self._world.layout.floor_z_m, tool[2])
        return self._sensor.shown((a, b, c + push_n, d, e, f), time_ns)
