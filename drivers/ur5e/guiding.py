"""Leading the arm by hand: begun with its tool set, ended in position control with the arm standing."""

from collections.abc import Callable

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.ur5e.link import ArmLink
from drivers.ur5e.motion import is_still
from drivers.ur5e.setup import refusal, wait_for_arm
from drivers.ur5e.shared_state import StateSample

STAND_LIMIT_S = 1.0


def begin_guiding(link: ArmLink, clock: Clock) -> None:
    """Let the arm be led by hand. Raises `DeviceError` where the controller refuses."""
    if not link.control.begin_guiding():
        raise refusal(link, "teachMode", clock)


def guided_sample(link: ArmLink) -> StateSample:
    """Return the newest sample. Raises `DeviceError` if guiding by hand has ended by itself.

    A program that was suspended would otherwise wait for a hand that can no longer lead the arm.
    """
    sample = link.sample()
    if link.guiding_lost:
        raise DeviceError(f"arm: guiding by hand had ended: {link.control.halted()}")
    return sample


def end_guiding(link: ArmLink, clock: Clock, stop: Callable[[], None]) -> None:
    """Hold the arm, and return when it stands; `stop` it where that does not happen.

    Raises `DeviceError` where it does not stand, and where guiding had ended before, with the reason.
    """
    try:
        halted = link.control.halted()
        link.control.end_guiding()
        wait_for_arm(lambda: is_still(link.sample()), STAND_LIMIT_S, "stand", clock)
    except BaseException:
        stop()
        raise
    if halted:
        raise DeviceError(f"arm: guiding by hand had ended: {halted}")
