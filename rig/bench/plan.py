"""The plan of a run, printed in advance: poses of the arm, limits, motions that would be rejected."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from drivers.errors import OutOfLimitsError
from drivers.motion import check_way, position_text
from drivers.types import Pose
from rig.bench.assembly import TOOL_DOWN
from rig.config import BenchConfig
from rig.config.devices import OwnArmConfig
from rig.config.models import TABLE

ARM_REACH_M = 0.85
"""Reach of a UR5e from its shoulder to the flange (data sheet)."""
SHOULDER_M = (0.0, 0.0, 0.1625)
"""Shoulder of a UR5e in the base frame (data sheet)."""
_SMALL_M, _SMALL_DEG = 0.0005, 0.05
"""Heights and turns that would be printed as 0 are left out."""
LINE_WIDTH = 100
"""Most characters in a printed line."""
UNGUARDED = (
    "WARNING: the arm has no force sensor (force_sensor = false). Its way down is NOT GUARDED: it does "
    "not stop if the hand meets an obstacle. Keep a hand on the emergency stop."
)


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """One target of the hand: the path `way` ends there, or leads through it, straight from pose to pose.

    what: for people, such as "t1/1 wrench, grip 1.9 mm". base_T_tcp: pose at which the fingers
    close, or the picture is taken. speed_m_s: highest speed on the path.
    """

    what: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    way: tuple[Pose, ...]
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps of a run, one line each, and why some of them would be rejected."""

    lines: tuple[str, ...]
    refused: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the plan as printed, in lines of at most `LINE_WIDTH` characters."""
        refused = [f"  WOULD BE REFUSED: {reason}" for reason in self.refused]
        folded = (
            wrap(line, LINE_WIDTH, subsequent_indent="      ", break_long_words=False, break_on_hyphens=False)
            for line in (*self.lines, *refused)
        )
        return "\n".join(part for parts in folded for part in parts)


def make_plan(config: BenchConfig, head: Sequence[str], motions: Sequence[PlannedMotion]) -> Plan:
    """Return the plan of a run. head: lines before the motions. config: also gives the limits.

    Joint angles are unknown in advance; the controller is asked for them before each motion.
    """
    lines = [*head, *(f"  {_line(config, motion)}" for motion in motions)]
    if motions:
        reach_m = max(_reach_m(config, motion) for motion in motions)
        speed_m_s = max(motion.speed_m_s for motion in motions)
        lines += [f"Fastest motion: {speed_m_s:.3f} m/s. Farthest reach: {reach_m:.2f} m.", *_limits(config)]
    if config.arm is not None and not config.arm.force_sensor:
        lines.append(UNGUARDED)
    refused = (_refusal(config, motion) for motion in motions)
    return Plan(tuple(lines), tuple(reason for reason in refused if reason))


def _line(config: BenchConfig, motion: PlannedMotion) -> str:
    x, y, z = motion.base_T_tcp.position_m
    height_m = z - config.require("table").position_m[2]
    over = f", {1e3 * height_m:.0f} mm over the mark" if abs(height_m) >= _SMALL_M else ""
    return f"{motion.what}: ({x:.3f}, {y:.3f}, {z:.3f}) m{over}{_turn(motion.base_T_tcp)}"


def _turn(base_T_tcp: Pose) -> str:  # noqa: N803 - frame names keep their case
    """Return how the hand is turned from pointing straight down; "" if it is not."""
    turns = (base_T_tcp.rotation * TOOL_DOWN.inv()).as_rotvec(degrees=True)
    about = {axis: f"{turn:+.1f}" for axis, turn in zip("xyz", turns, strict=True) if abs(turn) >= _SMALL_DEG}
    if not about:
        return ""
    if len(about) == 1:
        return "".join(f", turned {turn} deg about {axis}" for axis, turn in about.items())
    return f", turned ({', '.join(f'{turn:+.1f}' for turn in turns)}) deg"


def _reach_m(config: BenchConfig, motion: PlannedMotion) -> float:
    flange = config.require("arm").flange_T_tcp().inverse()
    ends = [(pose @ flange).position_m for pose in (motion.base_T_tcp, *motion.way)]
    return float(np.linalg.norm(np.subtract(ends, SHOULDER_M), axis=1).max())


def _limits(config: BenchConfig) -> list[str]:
    arm, fingers = config.arm_limits(), config.gripper_spec()
    joints = config.require("arm").limits
    reach = "" if isinstance(config.arm, OwnArmConfig) else f"reach {ARM_REACH_M:g} m, "
    table = [f"above the table (z > {1e3 * b.max_m[2]:.0f} mm)" for b in arm.keep_out if b.name == TABLE]
    boxes = [
        f"outside {b.name}, {position_text(b.min_m)} to {position_text(b.max_m)} m"
        for b in arm.keep_out
        if b.name != TABLE
    ]
    hand = f" (the hand can {1e3 * fingers.stroke_m:.0f})" if fingers.stroke_m > fingers.open_m else ""
    force = "no force limit" if arm.max_contact_force_n is None else f"{arm.max_contact_force_n:g} N"
    return [
        f"Limits: workspace {position_text(arm.workspace_min_m)} to {position_text(arm.workspace_max_m)} m,",
        f"  {arm.max_speed_m_s:g} m/s, {arm.max_acceleration_m_s2:g} m/s2, {force} on the way down, {reach}"
        f"joints {_angles(joints.joint_min_deg)} to {_angles(joints.joint_max_deg)} deg,",
        f"  fingers open to {1e3 * fingers.open_m:.0f} mm{hand}, and close in steps of "
        f"{1e3 * fingers.resolution_m:.2f} mm,",
        f"  free space: {'; '.join([*table, *boxes]) or 'the whole workspace'}.",
    ]


def _refusal(config: BenchConfig, motion: PlannedMotion) -> str | None:
    """Return why a motion would be rejected, or None; the reach of a user-defined arm is unknown."""
    limits = config.arm_limits()
    low, high = limits.workspace_min_m, limits.workspace_max_m
    reach_m = _reach_m(config, motion)
    try:
        for pose in motion.way:
            if not limits.has_inside(pose.position_m):
                raise OutOfLimitsError(
                    f"arm: {position_text(pose.position_m)} m leaves the workspace {position_text(low)} "
                    f"to {position_text(high)} m"
                )
        if motion.speed_m_s > limits.max_speed_m_s:
            raise OutOfLimitsError(
                f"arm: {motion.speed_m_s:.3f} m/s is more than {limits.max_speed_m_s:g} m/s"
            )
        if reach_m > ARM_REACH_M and not isinstance(config.arm, OwnArmConfig):
            raise OutOfLimitsError(
                f"arm: the flange would be {reach_m:.2f} m away, it reaches {ARM_REACH_M:g} m"
            )
        check_way(limits, motion.way)
    except OutOfLimitsError as error:
        return f"{motion.what.partition(',')[0].strip()}: {error}"
    return None


def _angles(angles: Sequence[float]) -> str:
    return f"{angles[0]:g}" if len(set(angles)) == 1 else "(" + ", ".join(f"{a:g}" for a in angles) + ")"
