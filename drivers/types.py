"""Frozen values that cross the device interfaces. SI units; other units are in the name."""

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.values import Vector3 as Vector3
from drivers.values import Vector6 as Vector6
from drivers.values import (
    invalid,
    require_fraction,
    require_integer,
    require_number,
    require_numbers,
    require_pose,
    require_type,
    short_repr,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Image = NDArray[np.uint8]
BEYOND_SHARE = 0.02
"""Share of the fingers' range by which a position may lie outside it: 5 counts of 6 to 255."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform `parent_T_child`: position in m, orientation as quaternion xyzw."""

    position_m: Vector3
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def from_rotation(cls, position_m: NDArray[np.float64] | Vector3, rotation: "Rotation") -> "Pose":
        """Build a pose from a position in m and a scipy rotation."""
        x, y, z = (float(v) for v in position_m)
        qx, qy, qz, qw = (float(v) for v in rotation.as_quat(canonical=True))
        return cls((x, y, z), (qx, qy, qz, qw))

    @property
    def rotation(self) -> "Rotation":
        """The orientation as a scipy rotation."""
        # takes half of what a program takes to start, and most commands turn nothing
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternion_xyzw)

    def __matmul__(self, other: "Pose") -> "Pose":
        """Compose: `a_T_b @ b_T_c` is `a_T_c`."""
        position = self.rotation.apply(other.position_m) + np.asarray(self.position_m)
        return Pose.from_rotation(position, self.rotation * other.rotation)

    def inverse(self) -> "Pose":
        """Return `child_T_parent`."""
        inverse = self.rotation.inv()
        return Pose.from_rotation(-inverse.apply(self.position_m), inverse)

    def translated(self, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> "Pose":
        """Return this pose moved along the parent's axes."""
        x, y, z = self.position_m
        return Pose((x + x_m, y + y_m, z + z_m), self.quaternion_xyzw)


class ArmMode(Enum):
    """What the arm's safety system allows."""

    RUNNING = "running"
    PROTECTIVE_STOP = "protective stop"
    EMERGENCY_STOP = "emergency stop"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class ArmState:
    """One sample of the arm. Its constructor raises `InvalidStateError` for any value that is invalid.

    time_ns: monotonic time at which the controller sampled it. base_T_tcp: the tool centre point in the
    base frame. joints_rad: the six joint angles. wrench: force (N) and torque (N m) at the TCP in base axes,
    None only for an arm without a force sensor, whose `ArmLimits.max_contact_force_n` is None.
    speed_fraction: the share of their speed at which motions run (the speed slider on the pendant), 0 to 1;
    None if unknown.
    """

    time_ns: int
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    joints_rad: Vector6
    wrench: Vector6 | None
    mode: ArmMode
    speed_fraction: float | None = None

    def __post_init__(self) -> None:
        require_integer("the arm's time_ns", self.time_ns)
        _require_pose("the arm's base_T_tcp", self.base_T_tcp)
        require_numbers("the arm's joints_rad", self.joints_rad, 6)
        if self.wrench is not None:
            require_numbers("the arm's wrench", self.wrench, 6)
        require_type("the arm's mode", self.mode, ArmMode)
        if self.speed_fraction is not None:
            require_fraction("the arm's speed_fraction", self.speed_fraction)

    @property
    def force_n(self) -> Vector3:
        """Force at the TCP in base axes, N. Raises `InvalidStateError` if the arm reported no wrench."""
        if self.wrench is None:
            raise invalid("the arm's wrench", None, "a tuple of 6 finite numbers")
        return self.wrench[:3]


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes of the base, m, from its lowest to its highest corner."""

    name: str
    min_m: Vector3
    max_m: Vector3


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """What the arm refuses to exceed: checked before a command is sent."""

    workspace_min_m: Vector3
    workspace_max_m: Vector3
    max_speed_m_s: float
    max_acceleration_m_s2: float
    max_payload_kg: float
    max_contact_force_n: float | None = 20.0
    """By how much the force at the tool may change on the way down. None: the arm has no force sensor, its
    states have no wrench, and the way down is not guarded."""
    keep_out: tuple[Box, ...] = ()
    """Where the tool centre point must not go, the hand around it reckoned in."""

    def has_inside(self, point_m: Vector3) -> bool:
        """Whether a point lies in the workspace; one that is no number does not."""
        sides = zip(self.workspace_min_m, point_m, self.workspace_max_m, strict=True)
        return all(low <= value <= high for low, value, high in sides)


@dataclass(frozen=True, slots=True)
class GripperState:
    """One sample of the gripper. Its constructor raises `InvalidStateError` for any value that is invalid.

    `position_counts` is the grasping fingers' position, rising while they close (`GripperLimits`);
    `current_counts` its motor current register, unscaled. There is no force here: the
    Robotiq 3-Finger gripper cannot measure one (manual, gCU is a current). `gripping`: a grasping
    finger met something while it closed, by the gripper's own account; a light grip goes unnoticed.
    `obstructed`: a grasping finger met something while it opened.
    """

    time_ns: int
    activated: bool
    moving: bool
    position_counts: int
    current_counts: int
    fault_code: int
    gripping: bool = False
    obstructed: bool = False

    def __post_init__(self) -> None:
        for name in ("time_ns", "position_counts", "current_counts", "fault_code"):
            require_integer(f"the gripper's {name}", getattr(self, name))
        require_number("the gripper's position_counts", self.position_counts, 0)
        for name in ("activated", "moving", "gripping", "obstructed"):
            require_type(f"the gripper's {name}", getattr(self, name), bool)


class Holding(StrEnum):
    """What the hand is known to do."""

    FREE = "free"
    """Nothing is held, and the hand is not around anything."""
    AROUND = "around"
    """The fingers stand open around something that rests on its support, or are on their way there."""
    HELD = "held"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class HandState:
    """What is known of the hand, from before it comes about until after it is over.

    what: around what, or holding what. base_T_grasp: TCP when the fingers closed, or will, None
    where nothing is. finger_counts: of the fingers when this became known, None if unknown.
    Its constructor raises `InvalidStateError` for any value that is invalid.
    """

    holding: Holding
    what: str = ""
    base_T_grasp: Pose | None = None  # noqa: N815 - frame names keep their case
    width_m: float = 0.0
    finger_counts: int | None = None

    def __post_init__(self) -> None:
        require_type("the hand's holding", self.holding, Holding)
        require_type("the hand's what", self.what, str)
        if self.base_T_grasp is not None:
            _require_pose("the hand's base_T_grasp", self.base_T_grasp)
        require_number("the hand's width_m", self.width_m)
        if self.finger_counts is not None:
            require_integer("the hand's finger_counts", self.finger_counts)


@dataclass(frozen=True, slots=True)
class GripperLimits:
    """Range of the gripper: counts, and the finger opening they stand for.

    min_counts: what the position reads when the fingers are open; max_counts: when they are closed.
    openings: measured pairs of counts (rising) and opening in m; between them the opening is
    interpolated, and the nominal line does not count.
    """

    min_counts: int
    max_counts: int
    max_opening_m: float
    opening_per_count_m: float
    openings: tuple[tuple[float, float], ...] = ()

    def require_possible(self, counts: int) -> None:
        """Raise `InvalidStateError` for a position that the fingers cannot have.

        Play and calibration error may take it out of the range by `BEYOND_SHARE` of the range.
        """
        beyond = BEYOND_SHARE * (self.max_counts - self.min_counts)
        low, high = self.min_counts - beyond, self.max_counts + beyond
        require_number("the gripper's position_counts", counts, low, high)

    @property
    def widest_m(self) -> float:
        """How wide the fingers open: measured, its nominal slope gone on with, or nominal."""
        if not self.openings:
            return self.max_opening_m
        counts, opening_m = self.openings[0]
        return opening_m + (counts - self.min_counts) * self.opening_per_count_m

    def opening_at(self, counts: float) -> float:
        """Return the finger opening in m that a position stands for, as `counts_for_opening` has it."""
        nominal_m = self.max_opening_m - (counts - self.min_counts) * self.opening_per_count_m
        if not self.openings:
            return nominal_m
        known, opening_m = (np.array(column) for column in zip(*self.openings, strict=True))
        inside = float(np.clip(counts, known.min(), known.max()))
        return float(np.interp(inside, known, opening_m)) + (inside - counts) * self.opening_per_count_m

    def counts_for_opening(self, opening_m: float) -> int:
        """Nearest position count for a finger opening in m: measured (`rig calibrate gripper`), or nominal.

        Beyond what was measured the nominal slope goes on from its end; beyond `widest_m`, open.
        """
        counts = self.min_counts + (self.max_opening_m - opening_m) / self.opening_per_count_m
        if self.openings:
            known, opening = (np.array(column) for column in zip(*self.openings, strict=True))
            inside = float(np.clip(opening_m, opening.min(), opening.max()))
            counts = float(np.interp(inside, opening[::-1], known[::-1]))
            counts += (inside - opening_m) / self.opening_per_count_m
        return int(min(max(round(counts), self.min_counts), self.max_counts))


def _require_pose(what: str, pose: object) -> None:
    if not isinstance(pose, Pose):
        raise invalid(what, pose, "a Pose")
    require_pose(what, pose.position_m, pose.quaternion_xyzw)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of a sensor or camera.

    image: (H, W, 3) uint8 RGB, origin top left, never mirrored; a DIGIT is 320 x 240.
    time_ns: monotonic capture time. sequence: counts captured frames, so a gap is a drop.
    serial: of the sensor. jpeg: the encoded bytes that `image` was decoded from, where the
    source delivers them; they are what the recorder keeps.
    """

    image: Image
    time_ns: int
    sequence: int
    serial: str
    jpeg: bytes | None = None

    __repr__ = short_repr
