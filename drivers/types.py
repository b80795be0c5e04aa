"""Immutable values of the device interfaces. SI units, unless the name states another unit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.errors import OutOfLimitsError
from drivers.values import Vector3 as Vector3
from drivers.values import Vector6 as Vector6
from drivers.values import (
    invalid,
    require_fraction,
    require_integer,
    require_number,
    require_numbers,
    require_type,
    short_repr,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Image = NDArray[np.uint8]
BEYOND_SHARE = 0.02
"""Share of the fingers' stroke by which a reported opening may lie outside the range: 3 mm of 155 mm."""
LARGEST_OPENING_M = 1.0
"""Largest absolute opening of a valid state; it rejects millimetres and counts in place of metres."""
_UNIT_TOLERANCE = 0.01
"""How far from 1 the norm of a quaternion may be."""
_TILT_M = 1e-9
"""Least change of a measured opening per step, so that the table can be inverted."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform `parent_T_child`: position in m, orientation as quaternion xyzw."""

    position_m: Vector3
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def from_rotation(cls, position_m: NDArray[np.floating] | Vector3, rotation: "Rotation") -> "Pose":
        """Build a pose from a position in m and a scipy rotation."""
        x, y, z = (float(v) for v in position_m)
        qx, qy, qz, qw = (float(v) for v in rotation.as_quat(canonical=True))
        return cls((x, y, z), (qx, qy, qz, qw))

    @property
    def rotation(self) -> "Rotation":
        """The orientation as a scipy rotation."""
        # imported here: it takes half of the start time of a program, and most commands rotate nothing
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

    def apart(self, other: "Pose") -> tuple[float, float]:
        """Return how far another pose is away: its position in m, and its orientation in rad."""
        straight = float(np.linalg.norm(np.subtract(other.position_m, self.position_m)))
        return straight, float((self.rotation.inv() * other.rotation).magnitude())

    def is_near(self, other: "Pose", most_m: float, most_rad: float) -> bool:
        """Whether another pose is at most this far away."""
        off_m, off_rad = self.apart(other)
        return off_m <= most_m and off_rad <= most_rad

    def translated(self, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> "Pose":
        """Return this pose moved along the parent's axes."""
        x, y, z = self.position_m
        return Pose((x + x_m, y + y_m, z + z_m), self.quaternion_xyzw)


class ArmMode(Enum):
    """Safety state of the arm."""

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
    """An axis-aligned box in the base frame, m, given by its lowest and its highest corner."""

    name: str
    min_m: Vector3
    max_m: Vector3


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Limits of the arm, checked before a command is sent."""

    workspace_min_m: Vector3
    workspace_max_m: Vector3
    max_speed_m_s: float
    max_acceleration_m_s2: float
    max_payload_kg: float
    max_contact_force_n: float | None = 20.0
    """Change of the force at the tool, N, at which a downward motion is stopped. None: the arm has no force
    sensor, its states have no wrench, and downward motions are not guarded."""
    keep_out: tuple[Box, ...] = ()
    """Boxes that the tool centre point must not enter; they already include the size of the hand."""

    def has_inside(self, point_m: Vector3) -> bool:
        """Whether a point lies in the workspace; False for a point with NaN."""
        sides = zip(self.workspace_min_m, point_m, self.workspace_max_m, strict=True)
        return all(low <= value <= high for low, value, high in sides)


BASIC_MODE = "basic"
"""Grasp mode in which the fingers oppose each other, as each protocol needs; activation ends in it."""


@dataclass(frozen=True, slots=True)
class GripperState:
    """One sample of the gripper. Its constructor raises `InvalidStateError` for any value that is invalid.

    opening_m: distance between the grasping fingertips, m. `gripping`: a grasping finger met an object while
    closing, as the gripper reports it; a light grip is not detected. `obstructed`: a grasping finger met an
    obstacle while opening. current_a: motor current, A; None if the gripper does not measure it. raw: the
    gripper's own readings by name; recordings keep `position_counts` and `current_counts`. mode: grasp mode
    of a gripper that has several; only in `BASIC_MODE` do its fingers close against each other.
    reclosed_from_m: largest opening from which the driver closed a kept grip again that had opened without a
    command (`Gripper.keep_grip`), m; None if there was none since `connect` or `activate`. There is no force,
    because the Robotiq 3-Finger gripper cannot measure one (manual, gCU is a current).
    """

    time_ns: int
    activated: bool
    moving: bool
    opening_m: float
    fault_code: int = 0
    gripping: bool = False
    obstructed: bool = False
    current_a: float | None = None
    raw: Mapping[str, int] = field(default_factory=dict, hash=False)
    mode: str = BASIC_MODE
    reclosed_from_m: float | None = None

    def __post_init__(self) -> None:
        require_type("the gripper's mode", self.mode, str)
        for name in ("time_ns", "fault_code"):
            require_integer(f"the gripper's {name}", getattr(self, name))
        require_number("the gripper's opening_m", self.opening_m, -LARGEST_OPENING_M, LARGEST_OPENING_M)
        for name in ("activated", "moving", "gripping", "obstructed"):
            require_type(f"the gripper's {name}", getattr(self, name), bool)
        for name in ("current_a", "reclosed_from_m"):
            if (value := getattr(self, name)) is not None:
                require_number(f"the gripper's {name}", value)
        require_type("the gripper's raw", self.raw, Mapping)
        for name, value in self.raw.items():
            require_type("a name in the gripper's raw", name, str)
            require_integer(f"the gripper's raw {name}", value)


class Holding(StrEnum):
    """Relation of the hand to an object."""

    FREE = "free"
    """Nothing is held, and the hand is not around anything."""
    AROUND = "around"
    """The fingers stand open around an object that rests on its support, or are on their way there."""
    HELD = "held"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class HandState:
    """The known state of the hand, set before an action begins and valid until after the action ends.

    what: name of the object that is held or surrounded. base_T_grasp: TCP pose at which the fingers closed or
    will close, None without an object. finger_opening_m: opening of the fingers when this state was set, None
    if unknown. The constructor raises `InvalidStateError` for any invalid value.
    """

    holding: Holding
    what: str = ""
    base_T_grasp: Pose | None = None  # noqa: N815 - frame names keep their case
    width_m: float = 0.0
    finger_opening_m: float | None = None

    def __post_init__(self) -> None:
        require_type("the hand's holding", self.holding, Holding)
        require_type("the hand's what", self.what, str)
        if self.base_T_grasp is not None:
            _require_pose("the hand's base_T_grasp", self.base_T_grasp)
        require_number("the hand's width_m", self.width_m)
        if self.finger_opening_m is not None:
            require_number("the hand's finger_opening_m", self.finger_opening_m)


@dataclass(frozen=True, slots=True)
class GripperSpec:
    """Range and resolution of a gripper.

    max_opening_m: nominal opening of the open fingers. stroke_m: distance by which they close from there; the
    nominal stroke may end below an opening of 0, where the fingertips press on each other. resolution_m: step
    size of the opening. Positions are counted in these steps, 0 is open. speed_m_s, force_n: lowest and
    highest value that may be commanded. measured: pairs of a position in steps (rising) and its measured
    opening in m (not rising). Openings are interpolated between them, and extrapolated by resolution_m per
    step.
    """

    max_opening_m: float
    stroke_m: float
    resolution_m: float
    speed_m_s: tuple[float, float]
    force_n: tuple[float, float]
    measured: tuple[tuple[float, float], ...] = ()

    @property
    def steps(self) -> int:
        """Number of steps from open to closed."""
        return round(self.stroke_m / self.resolution_m)

    @property
    def open_m(self) -> float:
        """Opening of the open fingers, m."""
        return self.opening_at(0)

    @property
    def closed_m(self) -> float:
        """Opening of the closed fingers, m."""
        return self.opening_at(self.steps)

    def opening_at(self, step: float) -> float:
        """Return the opening in m at a position in steps from open; also beyond the range."""
        if not self.measured:
            return self.max_opening_m - step * self.resolution_m
        known, openings = self._table()
        inside = float(np.clip(step, known[0], known[-1]))
        return float(np.interp(inside, known, openings)) + (inside - step) * self.resolution_m

    def step_at(self, opening_m: float) -> int:
        """Return the position nearest to an opening, in steps from open, within the range.

        It is the inverse of `opening_at` for each whole step of the range.
        """
        step = (self.max_opening_m - opening_m) / self.resolution_m
        if self.measured:
            known, openings = self._table()
            inside = float(np.clip(opening_m, openings[-1], openings[0]))
            step = float(np.interp(inside, openings[::-1], known[::-1]))
            step += (inside - opening_m) / self.resolution_m
        return min(max(round(step), 0), self.steps)

    def nearest(self, opening_m: float) -> float:
        """Return the opening of the nearest position within the range, m."""
        return self.opening_at(self.step_at(opening_m))

    def closer(self, opening_m: float, steps: int = 1) -> float:
        """Return the opening in m at `steps` steps closer than the position nearest to `opening_m`.

        Negative steps open. The result may be beyond the range.
        """
        return self.opening_at(self.step_at(opening_m) + steps)

    def steps_for(self, distance_m: float) -> int:
        """Return the number of steps nearest to a distance in m, at least 1."""
        return max(1, round(distance_m / self.resolution_m))

    def require_command(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> None:
        """Raise `OutOfLimitsError` for a motion outside the limits; None stands for the gripper's default.

        An opening less than half a step outside the range counts as the end of the range.
        """
        spare_m = self.resolution_m / 2
        if not self.closed_m - spare_m < opening_m < self.open_m + spare_m:
            low, high = 1e3 * self.closed_m, 1e3 * self.open_m
            raise OutOfLimitsError(
                f"gripper: an opening of {1e3 * opening_m:.2f} mm is outside {low:.2f} to {high:.2f} mm"
            )
        for what, value, (low, high), unit in (
            ("speed", speed_m_s, self.speed_m_s, "m/s"),
            ("force", force_n, self.force_n, "N"),
        ):
            if value is not None and not low <= value <= high:
                raise OutOfLimitsError(
                    f"gripper: a {what} of {value:g} {unit} is outside {low:g} to {high:g} {unit}"
                )

    def require_possible(self, opening_m: float) -> None:
        """Raise `InvalidStateError` for an opening that the fingers cannot have.

        Backlash and calibration error may exceed the range by `BEYOND_SHARE` of the stroke.
        """
        beyond_m = BEYOND_SHARE * self.stroke_m
        require_number("the gripper's opening_m", opening_m, self.closed_m - beyond_m, self.open_m + beyond_m)

    def _table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the measured positions, rising, and their openings, strictly falling."""
        known, openings = (np.array(column, np.float64) for column in zip(*self.measured, strict=True))
        return known, openings - _TILT_M * (known - known[0])


def _require_pose(what: str, pose: object) -> None:
    if not isinstance(pose, Pose):
        raise invalid(what, pose, "a Pose")
    require_numbers(f"{what} position_m", pose.position_m, 3)
    require_numbers(f"{what} quaternion_xyzw", pose.quaternion_xyzw, 4)
    if not abs(math.hypot(*pose.quaternion_xyzw) - 1.0) < _UNIT_TOLERANCE:
        raise invalid(f"{what} quaternion_xyzw", pose.quaternion_xyzw, "a quaternion of norm 1")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of a sensor or camera.

    image: (H, W, 3) uint8 RGB, origin top left, never mirrored; a DIGIT image is 320 x 240.
    time_ns: monotonic capture time. sequence: number of the captured frame, so a gap is a dropped frame.
    serial: serial number of the sensor. jpeg: the encoded bytes that `image` was decoded from, if the
    source delivers JPEG; the recorder stores these bytes.
    """

    image: Image
    time_ns: int
    sequence: int
    serial: str
    jpeg: bytes | None = None

    __repr__ = short_repr
