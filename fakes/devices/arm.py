"""A simulated UR5e: straight motions with trapezoidal speed, limits and protective stops."""

from collections.abc import Callable
from math import inf

from drivers.clock import Clock, wait_until
from drivers.errors import DeviceError, NotConnectedError, ProtectiveStopError
from drivers.interfaces import Arm
from drivers.motion import Motion, check_joints, check_motion
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector6
from fakes.faults import FaultScript
from fakes.world.force_torque import FlangeSensor
from fakes.world.kinematics import (
    ELBOW_UP,
    PHYSICAL_TOOL,
    Encoders,
    compose,
    forward,
    from_pose,
    inverse,
    nearest_inverse,
    to_pose,
    tracked_inverse,
)
from fakes.world.motion import ToolPath, TrapezoidProfile, distance
from fakes.world.world import World

STOP_DECELERATION_M_S2 = 10.0
"""As the driver of the real arm requests; a protective stop brakes at least as hard."""

LIMITS = ArmLimits(
    workspace_min_m=(0.15, -0.35, 0.01),
    workspace_max_m=(0.75, 0.35, 0.60),
    max_speed_m_s=0.5,
    max_acceleration_m_s2=1.5,
    max_payload_kg=5.0,
)

ANY_JOINTS: tuple[Vector6, Vector6] = (-inf, -inf, -inf, -inf, -inf, -inf), (inf, inf, inf, inf, inf, inf)


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
        self.limits, self._joint_limits, self._world = limits, joint_limits_rad or ANY_JOINTS, world
        self._clock, self._faults = clock, faults
        self._connected = False
        self._joints = ELBOW_UP
        self._pose: Pose | None = None
        self._released = self._guided = False
        self._sensor, self._encoders = FlangeSensor(world), Encoders(world.seed)

    def connect(self) -> None:
        self._connected = True

    def disconnect(self) -> None:
        if self._connected:
            self.stop()
        self._connected = False

    def state(self) -> ArmState:
        self._require_connected()
        now = self._clock.now_ns()
        pose = self._world.tool.pose_at(now)
        if pose != self._pose:
            self._pose, self._joints = pose, self._reach(pose, ANY_JOINTS, tracked_inverse)
        joints = self._encoders.measure(self._joints, now)
        height_m = self._world.tool.position_at(now)[2]
        return ArmState(
            now,
            to_pose(compose(forward(joints), PHYSICAL_TOOL)),
            joints,
            None if self.limits.max_contact_force_n is None else self._sensor.sense(now, height_m),
            ArmMode.PROTECTIVE_STOP if self._protective_stop(now) else ArmMode.RUNNING,
        )

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        self._require_connected()
        now = self._clock.now_ns()
        start = self._world.tool.pose_at(now)
        check_motion(self.limits, start, base_T_tcp, speed_m_s, acceleration_m_s2)
        self._reach(base_T_tcp, self._joint_limits)
        self._check_running()
        profile = TrapezoidProfile(now, distance(start, base_T_tcp), speed_m_s, acceleration_m_s2)
        self._world.tool = ToolPath.between(start, base_T_tcp, profile)
        return Motion("arm", self._clock, self._has_arrived, self.stop)

    def begin_guiding(self) -> None:
        self._require_connected()
        self._check_running()
        self._guided = True

    def end_guiding(self) -> None:
        if self._guided:
            self.stop()
            wait_until(self._clock, self._stands, 1.0, 0.004)

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
        self._guided = False
        self._world.tool = self._world.tool.braked_at(self._clock.now_ns(), STOP_DECELERATION_M_S2)

    def recover(self, confirm: Callable[[str], None]) -> None:
        self._require_connected()
        if self._protective_stop(self._clock.now_ns()):
            confirm("The arm is in protective stop. Is it free to move, and shall the stop be released?")
            self._released = True

    def _protective_stop(self, time_ns: int) -> bool:
        """Whether a protective stop is active: from the start of the fault until its end or its release."""
        active = self._faults.active("protective_stop", time_ns, "arm")
        self._released = self._released and active
        return active and not self._released

    def _stands(self) -> bool:
        return self._world.tool.profile.done_at(self._clock.now_ns())

    def _has_arrived(self) -> bool:
        self._check_running()
        return self._stands()

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

    def _reach(
        self,
        pose: Pose,
        limits_rad: tuple[Vector6, Vector6],
        solve: Callable[..., Vector6 | None] = nearest_inverse,
    ) -> Vector6:
        joints = solve(compose(from_pose(pose), inverse(PHYSICAL_TOOL)), self._joints)
        return check_joints(joints, limits_rad, pose)
