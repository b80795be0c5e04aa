"""Prepare the arm for motions, also after a stop; set its tool; guide it by hand. Nothing here moves the arm.

The tool that the controller has is compared first, and overwritten only after a person agreed. Guiding by
hand begins with the tool set, and ends in position control with the arm standing.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.clock import Clock, SystemClock, slowness_of, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.types import Vector3, Vector6
from drivers.ur5e.control_process import ControlCommands
from drivers.ur5e.controller import RELEASED, Dashboard
from drivers.ur5e.link import ArmLink
from drivers.ur5e.motion import PLAYING, is_still, program_reason, refused, stop_reason
from drivers.ur5e.shared_state import StateSample

RELEASE_LIMIT_S = 8.0
"""A protective stop can be released 5 s after it began (dashboard manual)."""
RELEASE_PAUSE_S = 0.5
"""Time between two attempts to release it."""
NORMAL_LIMIT_S, END_LIMIT_S = 3.0, 1.0
"""Time limits for leaving a released stop, and for ending a program on the controller."""
ZERO_LIMIT_S, ZEROED_N = 0.4, 3.0
"""Time limit for zeroing the force sensor, and the largest force that then counts as zero."""
REASON_LIMIT_S = 0.1
"""Longest delay between the answer to a command and the state sample that contains the reason."""
_POLL_S = 0.004
"""Interval at which the arm's state is polled."""
STAND_LIMIT_S, PAYLOAD_LIMIT_S = 1.0, 0.5
"""Time limits for standing still after guiding, and for reporting a payload that was set."""
SAME_TCP, SAME_KG, SAME_COG_M = 1e-4, 1e-3, 1e-3
"""Tolerances for equal settings: TCP in m and rad, mass in kg, centre of gravity in m."""


def take_over(link: ArmLink, dashboard: Dashboard, clock: Clock) -> None:
    """Start the control program and its watchdog; the controller keeps its tool.

    If a program runs while the arm stands still, it is ended first, because the control interface would only
    wait for its end. Raises `DeviceError` if the arm is not ready, or another program moves it.
    """
    sample = link.sample()
    if reason := stop_reason(sample):
        raise reason
    if sample.runtime_state == PLAYING:
        if not is_still(sample):
            raise DeviceError("arm: a program moves it; end that program on the pendant, then connect again")
        dashboard.ask("stop")
        wait_for_arm(lambda: link.sample().runtime_state != PLAYING, END_LIMIT_S, "end its program", clock)
    link.start_control()
    if not link.control.ask(ControlCommands.start_watchdog):
        raise refusal(link, "setWatchdog", clock)


def release(link: ArmLink, dashboard: Dashboard, clock: Clock) -> None:
    """Release a protective stop. The controller rejects an early release, so it is retried for a while.

    Raises `DeviceError` with the controller's answer if the stop cannot be released.
    """
    replies = [""]

    def released() -> bool:
        dashboard.ask("close safety popup")
        replies.append(dashboard.ask("unlock protective stop"))
        return replies[-1] == RELEASED

    try:
        wait_for_arm(released, RELEASE_LIMIT_S, "release the stop", clock, RELEASE_PAUSE_S)
    except DeviceTimeoutError as error:
        raise DeviceError(f"arm: the protective stop cannot be released: '{replies[-1]}'") from error
    wait_for_arm(lambda: stop_reason(link.sample()) is None, NORMAL_LIMIT_S, "leave the stop", clock)


def zero_force_sensor(link: ArmLink, clock: Clock) -> None:
    """Set the present force as zero. Raises `DeviceError` unless the arm is at rest and reads zero then."""
    if not link.control.ask(ControlCommands.is_steady):
        raise DeviceError("arm: not at rest; zero the force sensor half a second after a motion")
    if not link.control.ask(ControlCommands.zero_force_sensor):
        raise refusal(link, "zeroFtSensor", clock)

    answered_ns = SystemClock(slowness_of(clock)).now_ns()

    def zeroed() -> bool:
        sample = link.sample()  # a sample from before the answer still shows the old force
        return sample.sampled_ns > answered_ns and math.hypot(*sample.wrench[:3]) < ZEROED_N

    wait_for_arm(zeroed, ZERO_LIMIT_S, "zero its force sensor", clock)


def refusal(link: ArmLink, command: str, clock: Clock) -> DeviceError:
    return ended(link, clock) or refused(command)


def ended(link: ArmLink, clock: Clock) -> DeviceError | None:
    """Return why the control program does not run; None if it keeps running."""
    wait_until(clock, lambda: program_reason(link.sample()) is not None, REASON_LIMIT_S, _POLL_S)
    return program_reason(link.sample())


def wait_for_arm(
    met: Callable[[], bool], limit_s: float, what: str, clock: Clock, pause_s: float = _POLL_S
) -> None:
    """Poll `met` until the arm does `what`. Raises `DeviceTimeoutError` after `limit_s`."""
    if not wait_until(clock, met, limit_s, pause_s):
        raise DeviceTimeoutError(f"arm: did not {what} within {limit_s:g} s; see the pendant")


def begin_guiding(link: ArmLink, clock: Clock) -> None:
    """Let a person lead the arm by hand. Raises `DeviceError` if the controller rejects that."""
    if not link.control.ask(ControlCommands.begin_guiding):
        raise refusal(link, "teachMode", clock)


def guided_sample(link: ArmLink) -> StateSample:
    """Return the newest sample. Raises `DeviceError` if guiding by hand was ended by the heartbeat.

    Otherwise a program that had been suspended would wait for a person who can no longer lead the arm.
    """
    sample = link.sample()
    if link.guiding_lost:
        raise DeviceError(f"arm: guiding by hand had ended: {link.control.ask(ControlCommands.halted)}")
    return sample


def end_guiding(link: ArmLink, clock: Clock, stop: Callable[[], None]) -> None:
    """Hold the arm, and return when it stands; if it does not, call `stop`.

    Raises `DeviceError` if it does not stand, and, with the reason, if guiding had ended earlier.
    """
    try:
        halted = link.control.ask(ControlCommands.halted)
        link.control.ask(ControlCommands.end_guiding)
        wait_for_arm(lambda: is_still(link.sample()), STAND_LIMIT_S, "stand", clock)
    except BaseException:
        stop()
        raise
    if halted:
        raise DeviceError(f"arm: guiding by hand had ended: {halted}")


@dataclass(frozen=True, slots=True)
class Tool:
    """The tool at the flange: TCP (x y z in m, rotation vector in rad), mass, centre of gravity."""

    flange_tcp: Vector6
    payload_kg: float
    payload_cog_m: Vector3


class ToolSetting:
    """The tool of the bench file, and whether the controller has the same.

    When a program starts, the controller resets its tool to that of its installation, so they are compared
    each time. A person who agreed to overwrite a tool is not asked again for the same tool.
    """

    def __init__(self, tool: Tool, clock: Clock) -> None:
        self.tool, self._clock = tool, clock
        self._other: str | None = None
        self._agreed: set[str] = set()

    def compare(self, link: ArmLink) -> None:
        """Set the tool if the controller has the same one, or if overwriting its tool was agreed to."""
        self._other = other_tool(link, self.tool)
        if self._other is None or self._other in self._agreed:
            self._set(link)

    def agree(self, link: ArmLink, confirm: Callable[[str], None]) -> None:
        """Ask before the controller's tool is overwritten; `confirm` raises unless a person agrees."""
        if self._other is not None:
            confirm(
                f"The arm's controller has {self._other} in the bench file. Is the bench file right, and "
                "should the rig set it? (To avoid this question, set the same on the pendant.)"
            )
            self._agreed.add(self._other)
            self._set(link)

    def require(self) -> None:
        """Raise `DeviceError` while the controller has another tool that nobody agreed to overwrite."""
        if self._other is not None:
            raise DeviceError(
                f"arm: the controller has {self._other} in the bench file, and overwriting it was not "
                "confirmed; enter the same values in both"
            )

    def _set(self, link: ArmLink) -> None:
        set_tool(link, self.tool, self._clock)
        self._other = None


def other_tool(link: ArmLink, tool: Tool) -> str | None:
    """Describe how the controller's tool differs from `tool`; None if all values that it reports agree."""
    there, sample = link.control.ask(ControlCommands.tcp), link.sample()
    differs = []
    if _apart(there, tool.flange_tcp) > SAME_TCP:
        differs.append(f"TCP {_numbers(there)} instead of {_numbers(tool.flange_tcp)} (m, rad)")
    if abs(sample.payload_kg - tool.payload_kg) > SAME_KG:  # False for NaN: the controller does not report it
        differs.append(f"payload {sample.payload_kg:.3f} kg instead of {tool.payload_kg:.3f} kg")
    if _apart(sample.payload_cog_m, tool.payload_cog_m) > SAME_COG_M:
        there_cog, wanted = _numbers(sample.payload_cog_m), _numbers(tool.payload_cog_m)
        differs.append(f"centre of gravity {there_cog} m instead of {wanted} m")
    return ", ".join(differs) or None


def set_tool(link: ArmLink, tool: Tool, clock: Clock) -> None:
    """Set TCP and payload, and verify that the controller has them. Raises `DeviceError`."""
    taken, there = link.control.ask(ControlCommands.set_tcp, tool.flange_tcp)
    if not taken:
        raise refusal(link, "setTcp", clock)
    if _apart(there, tool.flange_tcp) > SAME_TCP:
        raise DeviceError(f"arm: the controller's TCP is {there} although {tool.flange_tcp} was set")
    if not link.control.ask(ControlCommands.set_payload, tool.payload_kg, tool.payload_cog_m):
        raise refusal(link, "setPayload", clock)
    if not math.isnan(link.sample().payload_kg):

        def weighed() -> bool:
            return abs(link.sample().payload_kg - tool.payload_kg) <= SAME_KG

        wait_for_arm(weighed, PAYLOAD_LIMIT_S, f"take the payload of {tool.payload_kg} kg", clock)


def _apart(there: Sequence[float], here: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(there, here, strict=True))


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
