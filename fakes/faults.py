"""Faults of simulated devices: on request while a device is served, or scripted with start and duration."""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import InputError, unknown_name

MOST = {"duration_s": 86_400, "delay_s": 3600, "code": 255, "size": 256, "seed": 2**31, "frames": 1_000_000}
"""Highest value of the arguments that are numbers."""
_WHOLE = ("code", "size", "seed", "frames")


@dataclass(slots=True)
class Faults:
    """The active faults of a device: each for a time, or until all are cleared. Usable from any thread.

    whose: the device, for messages. known: kinds of fault and the defaults of their arguments; all also take
    duration_s. now_ns: the device's time.
    """

    whose: str
    known: Mapping[str, Mapping[str, Any]]
    now_ns: Callable[[], int]
    _active: dict[str, tuple[dict[str, Any], int | None]] = field(default_factory=dict)
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def inject(self, kind: str, **arguments: Any) -> dict[str, Any]:
        """Start a fault and return its settings; end all with "clear".

        Raises `InputError` for an unknown kind or argument.
        """
        if kind == "clear":
            with self._lock:
                self._active.clear()
            return {}
        if kind not in self.known:
            raise unknown_name(f"fault of the {self.whose}", str(kind), (*self.known, "clear"))
        takes: dict[str, Any] = {**self.known[kind], "duration_s": None}
        if unknown := set(arguments) - set(takes):
            raise InputError(
                f"{self.whose}: fault '{kind}' has no {', '.join(sorted(unknown))}; "
                f"it takes {', '.join(takes)}"
            )
        for name, value in arguments.items():
            numbers = (int,) if name in _WHOLE else (int, float)
            if name in MOST and (type(value) not in numbers or not 0 <= value <= MOST[name]):
                what = "whole number" if name in _WHOLE else "number"
                raise InputError(
                    f"{self.whose}: {kind}: {name} {value!r}: give a {what} from 0 to {MOST[name]}"
                )
        settings = {**takes, **arguments}
        duration_s = settings.pop("duration_s")
        with self._lock:
            ends_ns = None if duration_s is None else self.now_ns() + to_ns(duration_s)
            self._active[kind] = settings, ends_ns
        return settings

    def get(self, kind: str) -> dict[str, Any] | None:
        """Return the settings of a fault, None if it is not active."""
        with self._lock:
            settings, ends_ns = self._active.get(kind, (None, None))
            if ends_ns is not None and self.now_ns() >= ends_ns:
                del self._active[kind]
                return None
            return settings

    def names(self) -> frozenset[str]:
        """Return the kinds of the active faults."""
        with self._lock:
            return frozenset(kind for kind in list(self._active) if self.get(kind) is not None)


OVERSHOOT_COUNTS = 30.0
"""Counts that a gripper with the fault `overshoot` moves beyond its target: about 19 mm of opening."""

DRIFT_COUNTS, DRIFT_COUNTS_S = 13, 20.0
"""Opening of fingers with the fault `drift`, in counts (about 8 mm), and its speed in counts per second."""


MOTIONLESS = frozenset(("stuck", "false_success"))
"""Faults with which the fingers do not move although the gripper reports that they arrived."""


def overshot(start: float, end: float, lowest: float, highest: float) -> float:
    """Return where a motion from `start` to `end` ends with the fault `overshoot`, all in counts."""
    if abs(end - start) < 0.5:
        return end
    return min(max(end + math.copysign(OVERSHOOT_COUNTS, end - start), lowest), highest)


KINDS = {
    "arm": ("protective_stop", "disconnect"),
    "gripper": ("fault", "disconnect", "blocked", "stuck", "false_success", "overshoot", "drift"),
    "tactile": ("freeze", "drop", "disconnect"),
    "camera": ("freeze", "drop", "disconnect"),
}
"""Kinds of fault by device.

Of a gripper: with `blocked` the fingers stop where they are, and the gripper reports it. With `stuck` they
stop and the reported position is correct, but the gripper reports success. `false_success` also reports the
requested position. With `overshoot` the fingers move too far in the direction of the motion. With `drift`
they open slowly by `DRIFT_COUNTS` without a command, once.
"""


@dataclass(frozen=True, slots=True)
class ScriptedFault:
    """One fault of one device, which begins `at_s` after the bench was made and lasts `duration_s`.

    device: arm, gripper, camera, tactile (all fingertips) or the serial of a sensor. kind: see `KINDS`. lift:
    the only lift with the fault ("t1/3": third lift of t1); None for all. attempt: the only attempt at a lift
    with the fault (0 is the first); None for all.
    """

    device: str
    kind: str
    at_s: float
    duration_s: float = 3600.0
    lift: str | None = None
    attempt: int | None = 0

    def __post_init__(self) -> None:
        known = KINDS.get(self.device, KINDS["tactile"])
        if self.kind not in known:
            raise unknown_name(f"fault of device '{self.device}'", self.kind, known)

    def concerns(self, lift: str, attempt: int) -> bool:
        return self.lift in (None, lift) and self.attempt in (None, attempt)


@dataclass(frozen=True, slots=True)
class FaultScript:
    """The faults of one bench, which each simulated device checks."""

    faults: tuple[ScriptedFault, ...] = ()

    def active(self, kind: str, time_ns: int, *names: str) -> bool:
        """Whether a fault of this kind is active at `time_ns` for a device with any of these names."""
        time_s = time_ns / NS_PER_S
        return any(
            fault.kind == kind
            and fault.device in names
            and fault.at_s <= time_s < fault.at_s + fault.duration_s
            for fault in self.faults
        )
