"""Faults of the simulated controller, on request."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.errors import InputError, unknown_name
from fakes.wire.net.side_channel import duration_ns
from fakes.wire.ur.robot import Robot

KINDS = {
    "protective_stop": "the arm stops itself; released over the dashboard, 5 s later at the earliest",
    "emergency_stop": "the button is pressed (clear turns it out again; the power stays off)",
    "program_killed": "the running program ends, as from the pendant's stop button",
    "stream_frozen": "no more data packages; with repeat=True the same one again and again",
    "socket_dropped": "all connections are closed; new ones are taken",
    "silent": "connections are taken and nothing is answered, on any port",
    "remote_control_off": "the pendant is switched to local: no program is taken from outside",
    "recipe_refused": 'variables (that begin with prefix=) are refused: reply="NOT_FOUND" or "IN_USE"',
    "clear": "ends all of these but the protective stop, which is released over the dashboard",
}
_ARGUMENTS = {"stream_frozen": {"repeat"}, "recipe_refused": {"reply", "prefix"}}
_LASTING = {"stream_frozen", "silent", "remote_control_off", "recipe_refused"}


@dataclass(slots=True)
class Faults:
    """The active faults; some end by themselves."""

    robot: Robot
    drop: Callable[[], None]
    frozen: bool = False
    repeat: bool = False
    silent: bool = False
    refusal: str | None = None
    refused_prefix: str = ""
    _ends_ns: int | None = None

    def check(self, kind: str, arguments: dict[str, Any]) -> None:
        """Raise `InputError` for an unknown fault, or arguments that it does not have."""
        if kind not in KINDS:
            raise unknown_name("fault of the simulated controller", kind, KINDS)
        known = _ARGUMENTS.get(kind, set()) | ({"duration_s"} if kind in _LASTING else set())
        if unknown := set(arguments) - known:
            raise InputError(
                f"simulated controller: fault '{kind}' has no {', '.join(sorted(unknown))}; "
                f"it takes {', '.join(sorted(known)) or 'nothing'}"
            )
        if arguments.get("reply", "IN_USE") not in ("IN_USE", "NOT_FOUND"):
            raise InputError("simulated controller: recipe_refused takes reply='NOT_FOUND' or 'IN_USE'")
        duration_ns(arguments.get("duration_s"), "simulated controller")

    def begin(self, kind: str, arguments: dict[str, Any]) -> None:
        """Start a fault that was checked."""
        robot = self.robot
        match kind:
            case "protective_stop":
                robot.protective_stop()
            case "emergency_stop":
                robot.safety.emergency_stop()
            case "program_killed":
                robot.end_program("killed")
            case "stream_frozen":
                self.frozen, self.repeat = True, bool(arguments.get("repeat", False))
            case "socket_dropped":
                self.drop()
            case "silent":
                self.silent = True
            case "remote_control_off":
                robot.safety.remote_control = False
            case "recipe_refused":
                self.refusal = arguments.get("reply", "IN_USE")
                self.refused_prefix = str(arguments.get("prefix", ""))
            case "clear":
                self.clear()
        lasts_ns = duration_ns(arguments.get("duration_s"), "simulated controller")
        if lasts_ns is not None:
            self._ends_ns = robot.time_ns + lasts_ns

    def refused(self, variable: str) -> str | None:
        """Return how a recipe with this variable is refused, None if it is not."""
        return self.refusal if variable.startswith(self.refused_prefix) else None

    def step(self, time_ns: int) -> None:
        """End the faults whose duration is over."""
        if self._ends_ns is not None and time_ns >= self._ends_ns:
            self.clear()

    def clear(self) -> None:
        """End all faults; the emergency stop button is released."""
        self.frozen = self.repeat = self.silent = False
        self.refusal = self._ends_ns = None
        self.robot.safety.remote_control = True
        self.robot.safety.release_button()
