"""Making the arm ready, and ready again after a stop: nothing here moves it."""

import math
from collections.abc import Callable

from drivers.clock import Clock, SystemClock, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.ur5e.dashboard import RELEASED, Dashboard
from drivers.ur5e.link import ArmLink
from drivers.ur5e.motion import is_still
from drivers.ur5e.status import PLAYING, program_reason, refused, stop_reason

RELEASE_LIMIT_S = 8.0
"""A protective stop can be released 5 s after it began (dashboard manual)."""
RELEASE_PAUSE_S = 0.5
NORMAL_LIMIT_S = 3.0
END_LIMIT_S = 1.0
ZERO_LIMIT_S, ZEROED_N = 0.4, 3.0
REASON_LIMIT_S = 0.1
"""How far the state that tells why may be behind the answer to a command."""
_POLL_S = 0.004


def take_over(link: ArmLink, dashboard: Dashboard, clock: Clock) -> None:
    """Start the control program and its watchdog; the tool is left as the controller has it.

    A program that runs while the arm stands still is ended first: the control interface would wait
    for its end without asking for it. Raises `DeviceError` when the arm is not ready, or another
    program moves it.
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
    if not link.control.start_watchdog():
        raise refusal(link, "setWatchdog", clock)


def release(link: ArmLink, dashboard: Dashboard, clock: Clock) -> None:
    """Release a protective stop; too early is refused, so it is asked for again for a while.

    Raises `DeviceError` with the controller's words when it cannot be released.
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
    """Take the present force as zero. Raises `DeviceError` unless the arm is at rest and it helps."""
    if not link.control.is_steady():
        raise DeviceError("arm: not at rest; zero the force sensor half a second after a motion")
    if not link.control.zero_force_sensor():
        raise refusal(link, "zeroFtSensor", clock)

    answered_ns = SystemClock().now_ns()

    def zeroed() -> bool:
        sample = link.sample()  # one from before the answer shows the force from before
        return sample.sampled_ns > answered_ns and math.hypot(*sample.wrench[:3]) < ZEROED_N

    wait_for_arm(zeroed, ZERO_LIMIT_S, "zero its force sensor", clock)


def refusal(link: ArmLink, command: str, clock: Clock) -> DeviceError:
    """Why a command came back False."""
    return ended(link, clock) or refused(command)


def ended(link: ArmLink, clock: Clock) -> DeviceError | None:
    """Why the control program does not run; None when it goes on running."""
    wait_until(clock, lambda: program_reason(link.sample()) is not None, REASON_LIMIT_S, _POLL_S)
    return program_reason(link.sample())


def wait_for_arm(
    met: Callable[[], bool], limit_s: float, what: str, clock: Clock, pause_s: float = _POLL_S
) -> None:
    """Wait until the arm does `what`, which `met` sees. Raises `DeviceTimeoutError` after `limit_s`."""
    if not wait_until(clock, met, limit_s, pause_s):
        raise DeviceTimeoutError(f"arm: did not {what} within {limit_s:g} s; see the pendant")
