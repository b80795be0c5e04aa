"""Teach where an object is grasped: a person brings the hand there, the fingers measure its width."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import OperatorStopError, OutOfLimitsError, ProtectiveStopError
from drivers.motion import POLL_S
from drivers.types import ArmMode, HandState, Holding, Pose
from protocols.observer import LiftObserver
from protocols.operator import Operator
from protocols.safe_end import safe_end
from protocols.slip_trial import REFERENCE_S
from protocols.steps import (
    MOTION_TIMEOUT_S,
    close_to_contact,
    guard,
    move_fingers,
    open_around,
    start_watching,
)

STEP_SPEED_M_S, STEP_ACCELERATION_M_S2 = 0.02, 0.2
"""Speed and acceleration of a step by keys."""
STEPS_M = {"1": 0.0005, "2": 0.002, "3": 0.01}
STEPS_DEG = {"1": 0.5, "2": 2.0, "3": 5.0}
"""Step by key, m and degrees."""
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
"""Axis of the base frame by key."""
KEYS = (
    "x y z step along the base's axes, X Y Z back; t turns the hand counter-clockwise as the camera sees it, "
    "T back; 1 2 3 steps of 0.5, 2, 10 mm (0.5, 2, 5 degrees); Enter when it is there; q stops"
)


@dataclass(frozen=True, slots=True)
class Taught:
    """A measured grasp. width_m: distance between the fingertips when both touch."""

    base_T_grasp: Pose  # noqa: N815 - frame names keep their case
    width_m: float


def lead_by_hand(bench: Bench, operator: Operator, question: str, where: Pose, limit_s: float) -> Pose:
    """Let a person lead the arm by hand until they confirm its arrival; return its TCP pose.

    At the end, also after an error, a stop or a time-out, the arm is held in position control and stands.
    Raises `OperatorStopError` after `limit_s`, `DeviceError`, `ProtectiveStopError`.
    """
    bench.arm.state()  # the first poll takes longest, and an arm that is being guided must be polled in time
    with operator.guide(question, where) as there:
        try:
            bench.arm.begin_guiding()
            end_ns = bench.clock.now_ns() + to_ns(limit_s)
            while not there():
                if bench.arm.state().mode is not ArmMode.RUNNING:
                    raise ProtectiveStopError(
                        "arm: it stopped itself while it was guided by hand; inspect it, then start again"
                    )
                if bench.clock.now_ns() >= end_ns:
                    raise OperatorStopError(
                        f"stopped: no confirmation within {limit_s:g} s that the hand is there"
                    )
                bench.clock.sleep_until(bench.clock.now_ns() + to_ns(POLL_S))
        finally:
            bench.arm.end_guiding()
    return bench.arm.state().base_T_tcp


def step_by_keys(bench: Bench, operator: Operator, question: str, where: Pose) -> Pose:
    """Step the arm by keys until a person confirms its arrival; return its TCP pose.

    Each key is one step at low speed, guarded by the force at the tool, and rejected if it would leave the
    limits. Raises `OperatorStopError`, `DeviceError`.
    """
    size, text = "2", f"{question} {KEYS}"
    with safe_end(bench):
        while True:
            here = bench.arm.state().base_T_tcp
            key = operator.key(text, where, here)
            text = ""
            if key == "enter":
                return here
            if key in STEPS_M:
                size = key
            elif (target := step_pose(here, key, size)) is not None:
                try:
                    before = bench.arm.state()
                    motion = bench.arm.move_linear(target, STEP_SPEED_M_S, STEP_ACCELERATION_M_S2)
                    guard(bench, motion, before).wait(MOTION_TIMEOUT_S)
                except OutOfLimitsError as error:
                    text = f"refused: {error}"


def step_pose(here: Pose, key: str, size: str) -> Pose | None:
    """Return the target pose of a key; None for a key without a step. size: "1", "2" or "3"."""
    sign = 1.0 if key == key.lower() else -1.0
    if (axis := AXES.get(key.lower())) is not None:
        x, y, z = sign * STEPS_M[size] * np.array(axis)
        return here.translated(x_m=float(x), y_m=float(y), z_m=float(z))
    if key.lower() == "t":
        turn = Rotation.from_euler("y", -sign * STEPS_DEG[size], degrees=True)
        return Pose.from_rotation(here.position_m, turn * here.rotation)
    return None


def open_hand(bench: Bench) -> None:
    """Open a free hand fully, before it is brought around an object."""
    reached = move_fingers(bench, bench.gripper.spec.open_m)
    bench.hand.note(HandState(Holding.FREE, finger_opening_m=reached.opening_m))


def measure_width(bench: Bench, observer: LiftObserver, what: str) -> Taught:
    """Close the fingers in place until both fingertips touch, and open them again around the object.

    Raises `GraspError` if nothing is between them, `DeviceError`; the hand then ends as in `safe_end`.
    """
    pose = bench.arm.state().base_T_tcp
    spec = bench.gripper.spec
    bench.hand.note(HandState(Holding.AROUND, what, pose, spec.open_m))
    with safe_end(bench):
        pump = start_watching(bench, observer, REFERENCE_S)
        width_m = close_to_contact(bench, pump, observer, spec.stroke_m)
        open_around(bench, width_m, pump)
        bench.hand.note(HandState(Holding.AROUND, what, pose, width_m))
    return Taught(pose, width_m)
