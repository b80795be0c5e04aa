"""Faults of a served device on request: which are known, their arguments, and when they end."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.clock import to_ns
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

    def begin(self, kind: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Start a fault and return its settings. Raises `InputError` for an unknown kind or argument."""
        if kind not in self.known:
            raise unknown_name(f"fault of the {self.whose}", str(kind), (*self.known, "clear"))
        takes: dict[str, Any] = {**self.known[kind], "duration_s": None}
        if unknown := set(arguments) - set(takes):
            raise InputError(
                f"{self.whose}: fault '{kind}' has no {', '.join(sorted(unknown))}; "
                f"it takes {', '.join(takes)}"
            )
        for name, value in arguments.items():
            self._check(kind, name, value)
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

    def clear(self) -> None:
        """End all faults."""
        with self._lock:
            self._active.clear()

    def _check(self, kind: str, name: str, value: Any) -> None:
        numbers = (int,) if name in _WHOLE else (int, float)
        if name in MOST and (type(value) not in numbers or not 0 <= value <= MOST[name]):
            what = "whole number" if name in _WHOLE else "number"
            raise InputError(f"{self.whose}: {kind}: {name} {value!r}: give a {what} from 0 to {MOST[name]}")
