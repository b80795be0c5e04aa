"""A 3-Finger gripper as a state machine behind its registers: activation, modes, motions, faults.

Byte positions and bits are those of the Robotiq 3-Finger manual (sections "Robot output registers" and "Robot
input registers"); nothing is shared with the driver. Durations and the scissor positions of three modes are
our assumptions, because the manual does not give them. Automatic release and individual control of the
scissor are not modelled.
"""

from dataclasses import dataclass

from drivers.clock import to_ns
from fakes.faults import MOTIONLESS, overshot
from fakes.world.motion import FingerPath
from fakes.world.world import FINGER_STIFFNESS_N_M, World

REFRESH_NS = 5_000_000
"""The registers are refreshed at 200 Hz: a status that is read sooner is still the one before."""
LATEST_NS = 2_000_000_000
"""Largest delay of a tick with which the fingers still stop where they met the object."""
IMAGE_BYTES = 16
RESET, ACTIVATING, CHANGING_MODE, READY = range(4)
SCISSOR_MODE = 3
AXES = ("A", "B", "C", "S")
OFFSETS: dict[str, int] = dict(zip(AXES, (3, 6, 9, 12), strict=True))
SCISSOR_OF_MODE = (0x89, 0xDC, 0x19, 0x19)
"""Scissor position of the modes basic (the manual's status example), pinch, wide and scissor (ours)."""
CLOSED_COUNTS = 255
MOVING_CURRENT = 0x0F
"""Current in the manual's example while the fingers close."""
MODE_CHANGE_S = 1.0
SLOWEST_M_S, FASTEST_M_S = 0.022, 0.110
WEAKEST_N, FORCE_PER_COUNT_N = 15.0, 0.175
MAJOR_FAULT = 0x0D


@dataclass(slots=True)
class FingerMotor:
    """One motor: its path, its request (position, speed, force), and its contact (gDT's 1 or 2, or 0)."""

    path: FingerPath
    asked: tuple[int, int, int] = (0, 0, 0)
    contact: int = 0

    def moving(self, now_ns: int) -> bool:
        return not self.path.profile.done_at(now_ns)

    def go(self, end: float, speed: float, now_ns: int) -> None:
        """Start towards `end`, in counts and counts per second."""
        self.path, self.contact = self.path.sent_to(end, speed, now_ns), 0

    def stop(self, now_ns: int) -> None:
        self.path = self.path.cut_at(now_ns)

    @property
    def closing(self) -> bool:
        return self.path.end > self.path.start


def mean_path(paths: list[FingerPath], now_ns: int) -> FingerPath:
    """Return one path for the opening between fingers, from now on.

    It is exact while the fingers move alike; otherwise it ends where they end, at their mean speed.
    """
    moving = [path for path in paths if not path.profile.done_at(now_ns)]
    here = sum(path.position_at(now_ns) for path in paths) / len(paths)
    end = sum(path.end if path in moving else path.position_at(now_ns) for path in paths) / len(paths)
    if not moving:
        return FingerPath.resting(here)
    longest = max(moving, key=lambda path: path.profile.duration_s).profile
    if longest.start_ns == now_ns:
        return FingerPath(here, end, longest)
    return FingerPath.resting(here).sent_to(end, longest.speed * len(moving) / len(paths), now_ns)


class GripperModel:
    """The device behind the registers. `tick` it every 5 ms; other calls only read or write bytes.

    fingers: the axes that carry the world's fingertips; the world's opening follows their mean. faults: names
    of the active faults: `deaf` ignores writes, the others are those of `fakes.faults.KINDS`.
    """

    def __init__(self, world: World, now_ns: int, fingers: tuple[str, ...], activation_s: float) -> None:
        self.written = bytearray(IMAGE_BYTES)
        self.faults: frozenset[str] = frozenset()
        self._world, self._fingers = world, fingers
        self._sweep_s = max(activation_s, 0.01) / 2
        self._open = float(world.layout.open_counts)
        scissor = float(SCISSOR_OF_MODE[0])
        starts = dict.fromkeys("ABC", world.fingers.position_at(now_ns)) | {"S": scissor}
        self.axes = {name: FingerMotor(FingerPath.resting(at)) for name, at in starts.items()}
        self._latched = bytes(IMAGE_BYTES)
        self._stage = RESET
        self._stage_ends_ns = 0
        self._swept = self._going = self._drifted = False
        self._mode = self._fault = 0
        self._ticked_ns = now_ns
        self.image = self._status(now_ns)

    def tick(self, now_ns: int) -> None:
        """Read the command registers, move, and refresh the status image."""
        before = [self.axes[name].path for name in self._fingers]
        for missed_ns in range(max(self._ticked_ns, now_ns - LATEST_NS) + REFRESH_NS, now_ns, REFRESH_NS):
            self._stop_at_contact(missed_ns)
        self._ticked_ns = now_ns
        request = self._latched if "deaf" in self.faults else bytes(self.written)
        self._take(request, now_ns)
        self._latched = request
        self._advance(now_ns)
        drifts = "drift" in self.faults
        if drifts and not self._drifted:
            for name in self._fingers:
                axis = self.axes[name]
                axis.path, axis.contact = axis.path.drifting(self._open, now_ns), 0
        self._drifted = drifts
        self._stop_at_contact(now_ns)
        paths = [self.axes[name].path for name in self._fingers]
        if paths != before:
            self._world.fingers = mean_path(paths, now_ns)
        self.image = self._status(now_ns)

    def fail(self, code: int, now_ns: int) -> None:
        """Raise a fault; from 0x0D on the gripper stops and needs a reset and an activation."""
        self._fault = code
        if code >= MAJOR_FAULT:
            self._stage, self._going = RESET, False
            self._stop(now_ns)

    def lose_power(self, now_ns: int) -> None:
        """Clear all registers; the fingers stay where they are."""
        self.written[:] = bytes(IMAGE_BYTES)
        self._reset(now_ns)
        self._latched = bytes(IMAGE_BYTES)
        self.image = self._status(now_ns)

    def clear_fault(self) -> None:
        """End a fault that needs no reset."""
        if self._fault < MAJOR_FAULT:
            self._fault = 0

    def _take(self, request: bytes, now_ns: int) -> None:
        if not request[0] & 1:
            self._reset(now_ns)
            return
        if not self._latched[0] & 1:
            self._stage, self._swept = ACTIVATING, False
            self._stage_ends_ns = now_ns + to_ns(self._sweep_s)
            self._sweep(CLOSED_COUNTS, now_ns)
        if self._stage == READY and request[0] >> 1 & 3 != self._mode:
            self._stop(now_ns)
            self._stage, self._going, self._mode = CHANGING_MODE, False, request[0] >> 1 & 3
            self._stage_ends_ns = now_ns + to_ns(MODE_CHANGE_S)
            self._turn_scissor(now_ns)

    def _reset(self, now_ns: int) -> None:
        self._stop(now_ns)
        self._stage, self._going, self._fault = RESET, False, 0

    def _stop(self, now_ns: int) -> None:
        for axis in self.axes.values():
            axis.stop(now_ns)
            axis.contact = 0

    def _sweep(self, end: float, now_ns: int) -> None:
        speed = 1.5 * (CLOSED_COUNTS - self._open) / self._sweep_s
        for name in "ABC":
            self.axes[name].go(end, speed, now_ns)

    def _turn_scissor(self, now_ns: int) -> None:
        self.axes["S"].go(float(SCISSOR_OF_MODE[self._mode]), 300.0, now_ns)

    def _advance(self, now_ns: int) -> None:
        if self._stage == ACTIVATING and now_ns >= self._stage_ends_ns:
            self._go_on_activating(now_ns)
        elif self._stage == CHANGING_MODE and now_ns >= self._stage_ends_ns:
            self._stage = READY
            if self.axes["S"].contact:
                self.fail(0x0E, now_ns)
        if self._stage == READY:
            self._follow(now_ns)

    def _go_on_activating(self, now_ns: int) -> None:
        if "blocked" in self.faults:
            self.fail(MAJOR_FAULT, now_ns)
        elif not self._swept:
            self._swept = True
            self._stage_ends_ns = now_ns + to_ns(self._sweep_s)
            self._sweep(self._open, now_ns)
        elif not any(axis.moving(now_ns) for axis in self.axes.values()):
            self._stage, self._mode = READY, self._latched[0] >> 1 & 3
            self._turn_scissor(now_ns)

    def _follow(self, now_ns: int) -> None:
        go_to = bool(self._latched[0] & 8)
        if go_to:
            individual = self._latched[1] & 4
            for name in "S" if self._mode == SCISSOR_MODE else "ABC":
                offset = OFFSETS[name if individual and name != "S" else "A"]
                self._ask(self.axes[name], self._latched[offset : offset + 3], now_ns, rearm=not self._going)
        elif self._going:
            self._stop(now_ns)
        self._going = go_to

    def _ask(self, axis: FingerMotor, request: bytes, now_ns: int, rearm: bool) -> None:
        """Pass an axis its request: position, speed, force.

        An axis in contact stays there unless it is sent back, is pressed harder, or rGTO has been set again.
        """
        position, speed, force = asked = request[0], request[1], request[2]
        if asked == axis.asked and not rearm:
            return
        end = max(float(position), self._open)
        back = (end < axis.path.position_at(now_ns)) == axis.closing
        if self.faults & MOTIONLESS:
            axis.stop(now_ns)
        elif rearm or not axis.contact or back or force > axis.asked[2]:
            if "overshoot" in self.faults:
                end = overshot(axis.path.position_at(now_ns), end, self._open, CLOSED_COUNTS)
            metres = SLOWEST_M_S + speed / 255 * (FASTEST_M_S - SLOWEST_M_S)
            axis.go(end, metres / self._world.layout.opening_per_count_m, now_ns)
        axis.asked = asked

    def _stop_at_contact(self, now_ns: int) -> None:
        moving = [(name, axis) for name, axis in self.axes.items() if axis.moving(now_ns)]
        if not moving:
            return
        resistance = FINGER_STIFFNESS_N_M * self._world.squeeze_at(now_ns)
        for name, axis in moving:
            limit = WEAKEST_N + FORCE_PER_COUNT_N * axis.asked[2]
            if self.faults & MOTIONLESS:
                axis.stop(now_ns)
            elif "blocked" in self.faults or (name != "S" and axis.closing and resistance >= limit):
                axis.stop(now_ns)
                axis.contact = 2 if axis.closing else 1

    def _status(self, now_ns: int) -> bytes:
        moving = [self.axes[name].moving(now_ns) for name in AXES]
        image = bytearray(IMAGE_BYTES)
        image[0] = self._latched[0] & 7 | self._going << 3 | self._stage << 4
        if self._going and not any(moving):
            stopped = sum(self.axes[name].contact > 0 for name in "ABC")
            image[0] |= {0: 3, 3: 2}.get(stopped, 1) << 6
        image[2] = self._fault or self._refusal()
        for number, name in enumerate(AXES):
            axis, offset = self.axes[name], OFFSETS[name]
            if self._going and not moving[number]:
                image[1] |= (axis.contact or 3) << 2 * number
            image[offset] = self._latched[offset]
            image[offset + 1] = round(axis.path.position_at(now_ns))
            if "false_success" in self.faults and self._going:
                image[offset + 1] = max(axis.asked[0], round(self._open))
            image[offset + 2] = MOVING_CURRENT if moving[number] else 0
        return bytes(image)

    def _refusal(self) -> int:
        """Return the priority fault of a motion that has to wait: 5, 6 or 7, also if rACT comes with rGTO."""
        if not self._latched[0] & 8:
            return 0
        if not self._latched[0] & 1:
            return 0x07
        return {ACTIVATING: 0x05, CHANGING_MODE: 0x06}.get(self._stage, 0)
