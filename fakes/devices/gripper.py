"""A simulated Robotiq 3-Finger gripper: activation, motion in whole counts, contact by object width."""

from drivers.clock import Clock, to_ns
from drivers.errors import DeviceError, GripperFaultError, NotConnectedError
from drivers.interfaces import Gripper
from drivers.motion import Motion
from drivers.types import BASIC_MODE, GripperSpec, GripperState
from fakes.faults import MOTIONLESS, FaultScript, overshot
from fakes.world.state import BenchLayout
from fakes.world.world import FINGER_STIFFNESS_N_M, STALL_FORCE_N, World

SPEED_M_S, FORCE_N = (0.022, 0.110), (STALL_FORCE_N, 60.0)
"""Lowest and highest speed and force (manual, SPEED and FORCE registers)."""
ACTIVATION_S = 3.0
ACTIVATION_NEEDED = 0x05
ACTIVATION_FAULT = 0x0D


def nominal_spec(layout: BenchLayout) -> GripperSpec:
    """Return the nominal range of the fingers of a simulated bench."""
    step_m = layout.opening_per_count_m
    stroke_m = (layout.closed_counts - layout.open_counts) * step_m
    return GripperSpec(layout.max_opening_m, stroke_m, step_m, SPEED_M_S, FORCE_N)


class FakeGripper(Gripper):
    """Moves the fingers of the world; the third finger stays parked.

    spec: range of the fingers, by default the nominal one; a step is one count. period_s: polling period of
    the connection: fingers start and stop one period late, and states are one period old.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        faults: FaultScript,
        spec: GripperSpec | None = None,
        period_s: float = 0.0,
    ) -> None:
        self.spec = spec or nominal_spec(world.layout)
        self._period_ns = to_ns(period_s)
        self._world, self._clock, self._faults = world, clock, faults
        self.mode = BASIC_MODE
        """Grasp mode; another program or the device's own page may have changed it."""
        self._connected = self._activated = False
        self._requested = world.layout.open_counts
        self._stalls = self._drifts = self._drifted = False
        self._force_n = STALL_FORCE_N
        self._motion: tuple[float, float | None, float | None] | None = None
        """Arguments of the last `move_to`, if no other command was given since."""
        self._most_m: float | None = None
        self._reclosed_from_m: float | None = None

    def connect(self) -> None:
        self.disconnect()
        self._connected, self._reclosed_from_m = True, None

    def disconnect(self) -> None:
        if self._connected:
            self.stop()
        self._connected = False

    def activate(self) -> None:
        self._require_usable()
        self._clock.sleep_until(self._clock.now_ns() + to_ns(ACTIVATION_S))
        self._activated, self.mode, self._reclosed_from_m = True, BASIC_MODE, None
        self.move_to(self.spec.open_m).wait(timeout_s=5.0)

    def state(self) -> GripperState:
        self._require_usable()
        drifted, self._drifted = self._drifted, self._has("drift")
        if self._drifted and not drifted:
            self._drifts = True
            lowest = float(self._world.layout.open_counts)
            self._world.fingers = self._world.fingers.drifting(lowest, self._clock.now_ns())
        now = self._clock.now_ns() - self._period_ns
        squeeze = self._world.squeeze_at(now)
        counts = round(self._world.fingers.position_at(now))
        shown = self._requested if self._has("false_success") else counts
        opening_m = self.spec.opening_at(shown - self._world.layout.open_counts)
        if self._motion is not None and self._most_m is not None and opening_m > self._most_m:
            before_m, most_m = self._reclosed_from_m, self._most_m
            self._reclosed_from_m = opening_m if before_m is None else max(before_m, opening_m)
            self.move_to(*self._motion)
            self._most_m = most_m
        blocked, stalled = self._has("blocked"), squeeze * FINGER_STIFFNESS_N_M >= self._force_n
        return GripperState(
            time_ns=now,
            activated=self._activated,
            moving=not self._drifts and not self._world.fingers.profile.done_at(now),
            opening_m=opening_m,
            gripping=stalled or self._stalls or (blocked and self._requested > counts),
            obstructed=blocked and self._requested < counts,
            raw={"position_counts": shown, "current_counts": round(4 + 6 * squeeze * FINGER_STIFFNESS_N_M)},
            mode=self.mode,
            reclosed_from_m=self._reclosed_from_m,
        )

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the fingers; they stall if an object resists with `force_n`, 15 N by default.

        speed_m_s: by default the middle of the range.
        """
        self._require_usable()
        if not self._activated:
            raise GripperFaultError(
                "gripper: not activated; ask for activation first (the fingers will sweep their range)",
                ACTIVATION_NEEDED,
            )
        self.spec.require_command(opening_m, speed_m_s, force_n)
        self._motion, self._most_m = (opening_m, speed_m_s, force_n), None
        layout = self._world.layout
        position_counts = layout.open_counts + self.spec.step_at(opening_m)
        self._force_n = STALL_FORCE_N if force_n is None else force_n
        speed_m_s = sum(self.spec.speed_m_s) / 2 if speed_m_s is None else speed_m_s
        now = self._clock.now_ns() + self._period_ns
        end = self._end(position_counts, now)
        self._requested, self._drifts = position_counts, False
        self._stalls = self._stall_counts(now) <= end < position_counts
        self._world.fingers = self._world.fingers.sent_to(end, speed_m_s / layout.opening_per_count_m, now)
        return Motion("gripper", self._clock, self._has_arrived, self.stop)

    def keep_grip(self, most_m: float) -> None:
        """Keep the grip as `Gripper.keep_grip` describes. The fingers are checked when the state is read."""
        self._require_usable()
        self._most_m = most_m

    def stop(self) -> None:
        self._stalls, self._motion, self._most_m = False, None, None
        self._world.fingers = self._world.fingers.cut_at(self._clock.now_ns() + self._period_ns)

    def _end(self, position_counts: int, now_ns: int) -> float:
        """Return the end of a motion in counts: its target, an object, or the position at a fault."""
        start = self._world.fingers.position_at(now_ns)
        if any(self._has(kind) for kind in ("blocked", *MOTIONLESS)):
            return start
        end = float(position_counts)
        if self._has("overshoot"):
            end = overshot(start, end, self._world.layout.open_counts, self._world.layout.closed_counts)
        return min(end, max(start, self._stall_counts(now_ns)))

    def _has(self, kind: str) -> bool:
        return self._faults.active(kind, self._clock.now_ns(), "gripper")

    def _has_arrived(self) -> bool:
        self._require_usable()
        return self._world.fingers.profile.done_at(self._clock.now_ns() - self._period_ns)

    def _stall_counts(self, time_ns: int) -> float:
        squeeze = self._world.squeeze_at(time_ns)
        if squeeze <= 0.0:
            return float(self._world.layout.closed_counts)
        spare_m = self._force_n / FINGER_STIFFNESS_N_M - squeeze
        return self._world.fingers.position_at(time_ns) + spare_m / self._world.layout.opening_per_count_m

    def _require_usable(self) -> None:
        now = self._clock.now_ns()
        if not self._connected:
            raise NotConnectedError("gripper: used before connect; connect the bench first")
        if self._faults.active("disconnect", now, "gripper"):
            raise DeviceError("gripper: no answer; check power and cable, then start again")
        if self._faults.active("fault", now, "gripper"):
            self._activated = False
            raise GripperFaultError(
                "gripper: fault 0x0D (activation fault); free the fingers, then activate again",
                ACTIVATION_FAULT,
            )
