"""What can go wrong with the simulated controller, on request."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.errors import InputError, unknown_name
from fakes.wire.net.arguments import duration_ns
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
    "clear": "ends all of these but the protective stop, which the arm's own way releases",
}
_ARGUMENTS = {"stream_frozen": {"repeat"}, "recipe_refused": {"reply", "prefix"}}
_LASTING = {"stream_frozen", "silent", "remote_control_off", "recipe_refused"}


@dataclass(slots=True)
class Faults:
    """The faults that are on; some end by themselves."""

    robot: Robot
    drop: Callable[[], None]
    frozen: bool = False
    repeat: bool = False
    silent: bool = False
    refusal: str | None = None
    refused_prefix: str = ""
    _ends_ns: int | None = None

    def check(self, kind: str, arguments: dict[str, Any]) -> None:
        """Raise `InputError` for a fault that does not exist, or arguments that are not its own."""
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
        """Begin a fault that was checked."""
        robot = self.robot
        actions: dict[str, Callable[[], None]] = {
            "protective_stop": robot.protective_stop,
            "emergency_stop": robot.safety.emergency_stop,
            "program_killed": lambda: robot.end_program("killed"),
            "stream_frozen": lambda: self._freeze(bool(arguments.get("repeat", False))),
            "socket_dropped": self.drop,
            "silent": lambda: self._set(silent=True),
            "remote_control_off": lambda: self._remote(on=False),
            "recipe_refused": lambda: self._refuse(
                arguments.get("reply", "IN_USE"), str(arguments.get("prefix", ""))
            ),
            "clear": self.clear,
        }
        actions[kind]()
        lasts_ns = duration_ns(arguments.get("duration_s"), "simulated controller")
        if lasts_ns is not None:
            self._ends_ns = robot.time_ns + lasts_ns

    def refused(self, variable: str) -> str | None:
        """How a recipe with this variable is refused; None when it is not."""
        return self.refusal if variable.startswith(self.refused_prefix) else None

    def step(self, time_ns: int) -> None:
        """End what has had its time."""
        if self._ends_ns is not None and time_ns >= self._ends_ns:
            self.clear()

    def clear(self) -> None:
        """End all faults; a pressed button is turned out."""
        self.frozen = self.repeat = self.silent = False
        self.refusal = self._ends_ns = None
        self._remote(on=True)
        self.robot.safety.release_button()

    def _freeze(self, repeat: bool) -> None:
        self.frozen, self.repeat = True, repeat

    def _set(self, silent: bool) -> None:
        self.silent = silent

    def _remote(self, on: bool) -> None:
        self.robot.safety.remote_control = on

    def _refuse(self, reply: str, prefix: str) -> None:
        self.refusal, self.refused_prefix = reply, prefix
