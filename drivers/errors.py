"""The one error tree of the rig.

Every message names the device or file, what was seen, and what to do about it. The command
line maps the branches to exit codes (0 done, 1 rig fault, 2 usage or input, 3 stopped by the
operator), so an error raised anywhere reaches the user as one line.
"""

from collections.abc import Iterable
from difflib import get_close_matches


class RigError(Exception):
    """Base of every error this product raises on purpose."""


class DeviceError(RigError):
    """A device of the bench failed; the lift in progress is a rig fault, not a result."""


class NotConnectedError(DeviceError):
    """A device was used before `connect` or after `disconnect`."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer, or a motion did not end, within its time."""


class InvalidStateError(DeviceError):
    """A driver reported a value that no state can have: NaN, infinity, a wrong type, length or range."""


class StaleFrameError(DeviceError):
    """The newest frame of a sensor is older than the caller allows."""


class DamagedFrameError(DeviceError):
    """An image arrived cut short or garbled; the stream it came in may still be good."""


class ProtectiveStopError(DeviceError):
    """The arm stopped itself; a person has to look before it moves again."""


class ContactForceError(DeviceError):
    """The arm met something on its way down, and was stopped."""


class GripperFaultError(DeviceError):
    """The gripper reports a fault code.

    `code` is the gFLT value of the Robotiq 3-Finger manual.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class OutOfLimitsError(DeviceError):
    """A command was refused before it was sent because it exceeds a stated limit."""


class GraspError(DeviceError):
    """The fingers closed without both sensors reporting contact."""


class FingerMotionError(DeviceError):
    """The fingers missed their target position, or still touch an object after they opened."""


class RecordingError(RigError):
    """Results could not be written (full disk, no permission, session in use)."""


class InputError(RigError):
    """The user's input (argument, file, folder) cannot be used as it is."""


class FormatError(InputError):
    """A file is not what its format demands, or larger than any of its kind."""


class SessionError(InputError):
    """A session folder is missing, damaged, or does not fit the request."""


class EstimatorError(InputError):
    """An estimator of somebody's own cannot be made, or answers what cannot be."""


class CalibrationError(InputError):
    """A calibration is missing, degenerate, or belongs to another device."""


class OperatorStopError(RigError):
    """The operator stopped the run; the rig has been brought to a safe state."""


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is one: "1 lift", "3 lifts"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def nearest(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" with the known name that is most like `name`, or an empty text."""
    by_lower_case = {each.lower(): each for each in known}
    near = get_close_matches(name.lower(), by_lower_case, n=1)
    return f" (did you mean '{by_lower_case[near[0]]}'?)" if near else ""


def unknown_name(
    what: str, name: str, known: Iterable[str], also: str = "", listed: str | None = None
) -> InputError:
    """Return the error for an unknown name, with the nearest known name and a list of all.

    what: the kind of name, such as "estimator". also: further advice, behind the list. listed: the list as
    it is shown, if not the known names themselves.
    """
    names = list(known)
    listed = listed or ", ".join(names)
    return InputError(f"unknown {what} '{name}'{nearest(name, names)}: choose one of {listed}{also}")
