"""The exception hierarchy of the rig.

Every message names the device or file, what was seen, and what to do about it. The command
line maps the branches to exit codes (0 done, 1 rig fault, 2 usage or input, 3 stopped by the
operator), so an error raised anywhere reaches the user as one line, or as a line for each fault of a file.
"""

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path

_MEASURED = re.compile(r"\d+(?:\.\d+)? (?=(?:s|ms|m|mm|deg|N|kg)\b)")
"""A measured value in a message, before its unit."""
_LOGIN = re.compile(r"(://[^/@\s:]*):[^/\s]*@")
_SECRET = re.compile(r"([?&][^=&\s]*(?:pass|pwd|token|secret|auth|key)[^=&\s]*=)[^&\s'\"]+", re.IGNORECASE)


class RigError(Exception):
    """Base class of every error that this product raises on purpose."""


class DeviceError(RigError):
    """A device of the bench failed; the lift in progress is a rig fault, not a result."""


class NotConnectedError(DeviceError):
    """A device was used before `connect` or after `disconnect`."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer, or a motion did not end, within its time limit."""


class InvalidStateError(DeviceError):
    """A driver reported an invalid value in a device state: NaN, infinity, a wrong type, length or range."""


class StaleFrameError(DeviceError):
    """The newest frame of a sensor is older than the caller allows."""


class DamagedFrameError(DeviceError):
    """An image arrived truncated or corrupted; the rest of its stream may still be good.

    kind: name of the counter of such images.
    """

    def __init__(self, message: str, kind: str = "damaged") -> None:
        super().__init__(message)
        self.kind = kind


class ProtectiveStopError(DeviceError):
    """The arm stopped itself; a person has to inspect it before it moves again."""


class ContactForceError(DeviceError):
    """The arm met an obstacle while it moved down, and was stopped."""


class GripperFaultError(DeviceError):
    """The gripper reports a fault code.

    `code` is the gFLT value of the Robotiq 3-Finger manual.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class OutOfLimitsError(DeviceError):
    """A command was rejected before it was sent because it exceeds a stated limit."""


class GraspError(DeviceError):
    """The fingers closed without both sensors reporting contact."""


class FingerMotionError(DeviceError):
    """The fingers missed their target position, or still touch an object after they opened."""


class RecordingError(RigError):
    """Results could not be written (full disk, no permission, session in use)."""


class InputError(RigError):
    """The user's input (argument, file, folder) cannot be used as it is."""


class FormatError(InputError):
    """A file does not follow its format, or exceeds the size limit of that format."""


class FileFaultsError(InputError):
    """A file has faults. lines: the message, a line for each fault, with its place."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


class SessionError(InputError):
    """A session folder is missing, damaged, or does not fit the request."""


class EstimatorError(InputError):
    """A user-defined estimator cannot be created, or returns an invalid value."""


class CalibrationError(InputError):
    """A calibration is missing, degenerate, or belongs to another device."""


class OperatorStopError(RigError):
    """The operator stopped the run; the rig has been brought to a safe state."""


def plural(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless the number is 1: "1 lift", "3 lifts"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def without_values(text: str) -> str:
    """Return an error message without its measured values ("0.41 s", "3 mm"): equal for the same cause."""
    return _MEASURED.sub("", text)


def nearest(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" with the known name closest to `name`, or an empty string."""
    by_lower_case = {each.lower(): each for each in known}
    near = get_close_matches(name.lower(), by_lower_case, n=1)
    return f" (did you mean '{by_lower_case[near[0]]}'?)" if near else ""


def no_such(path: Path, what: str = "file or folder", cure: str = "check the path") -> str:
    """Return the message on a missing path, with the name of the one beside it that the user may mean."""
    near = ""
    with suppress(OSError):
        near = nearest(path.name, [other.name for other in path.parent.iterdir()])
    return f"{path}: there is no such {what}{near}: {cure}"


def unknown_name(
    what: str, name: str, known: Iterable[str], also: str = "", listed: str | None = None
) -> InputError:
    """Return the error for an unknown name, with the nearest known name and a list of all names.

    what: the kind of name, such as "estimator". also: further advice, after the list. listed: text to print
    as the list; default: the known names.
    """
    names = list(known)
    listed = listed or ", ".join(names)
    return InputError(f"unknown {what} '{name}'{nearest(name, names)}: choose one of {listed}{also}")


def without_passwords(text: str) -> str:
    """Replace the passwords of web addresses in a text by ***."""
    return _SECRET.sub(r"\1***", _LOGIN.sub(r"\1:***@", text))
