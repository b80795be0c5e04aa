"""The dashboard server of the simulated controller: one line in, one line out, on port 29999.

Universal Robots, "Dashboard Server e-Series". Replies are worded as that page words them.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import InputError
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.safety import RobotMode, SafetyMode
from fakes.wire.ur.script import ScriptProgram

BANNER = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE = 4096
UNNAMED = "<unnamed>"
"""A program that came from outside, or none."""
_SINCE_5S = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)
Start = Callable[[ScriptProgram], bool]


@dataclass(slots=True)
class DashboardServer:
    """What the dashboard knows and answers. start: runs a program on the robot."""

    robot: Robot
    serial_number: str
    start: Start
    program: str = ""
    user_role: str = "NONE"

    def reply(self, line: str) -> str:
        """Answer one request."""
        text = line.strip()
        for request, handler in _REQUESTS.items():
            if text.lower() == request.lower():
                return handler(self, "")
        for request, handler in _WITH_ARGUMENT.items():
            if text.lower().startswith(request.lower()):
                return handler(self, text[len(request) :].strip())
        return f'could not understand: "{text}"'

    def version(self) -> str:
        """The software's version, as PolyscopeVersion prints it."""
        return "URSoftware {}.{}.{}.{} (Jun 30 2021)".format(*self.robot.version)

    def state(self) -> str:
        """State and name of the program."""
        running = "PAUSED" if self.robot.paused else "PLAYING"
        return f"{running if self.robot.running else 'STOPPED'} {self.program or UNNAMED}"

    def unlock(self) -> str:
        """Release a protective stop, unless it is too early."""
        return "Protective stop releasing" if self.robot.safety.unlock(self.robot.time_ns) else _SINCE_5S

    def play(self) -> str:
        """Start the loaded program; what it does is not simulated, it runs until it is stopped."""
        safety = self.robot.safety
        if self.robot.paused:
            self.robot.paused = False
            return "Starting program"
        ready = self.program and safety.remote_control
        if ready and self.start(ScriptProgram(self.program, ("sleep(3600)",))):
            return "Starting program"
        return "Failed to execute: play"

    def stop(self) -> str:
        """End the running program."""
        self.robot.end_program("stopped on the dashboard")
        return "Stopped"

    def pause(self) -> str:
        """Pause the running program."""
        if not self.robot.running:
            return "Failed to execute: pause"
        self.robot.paused = True
        return "Pausing program"

    def load(self, name: str) -> str:
        """Choose a program by name."""
        if not name.endswith(".urp"):
            return f"File not found: {name}"
        self.program = name
        return f"Loading program: {name}"

    def set_user_role(self, role: str) -> str:
        """Note the role of who stands at the pendant."""
        self.user_role = role
        return f"Setting user role: {role}"

    def power(self, mode: RobotMode, reply: str) -> str:
        """Switch on, release the brakes, or switch off."""
        return reply if self.robot.safety.power(mode, self.robot.time_ns) else "Failed: emergency stop"


def _safety_text(dashboard: DashboardServer) -> str:
    return SafetyMode(dashboard.robot.safety.mode).name


def _said(reply: str) -> Callable[[DashboardServer, str], str]:
    return lambda _dashboard, _argument: reply


_REQUESTS: dict[str, Callable[[DashboardServer, str], str]] = {
    "PolyscopeVersion": lambda d, _: d.version(),
    "version": lambda d, _: ".".join(map(str, d.robot.version)),
    "get serial number": lambda d, _: d.serial_number,
    "get robot model": _said("UR5"),
    "is in remote control": lambda d, _: str(d.robot.safety.remote_control).lower(),
    "get operational mode": _said("NONE"),
    "running": lambda d, _: f"Program running: {str(d.robot.running).lower()}",
    "robotmode": lambda d, _: f"Robotmode: {d.robot.safety.robot_mode.name}",
    "safetymode": lambda d, _: f"Safetymode: {_safety_text(d)}",
    "safetystatus": lambda d, _: f"Safetystatus: {_safety_text(d)}",
    "programState": lambda d, _: d.state(),
    "isProgramSaved": lambda d, _: f"True {d.program or UNNAMED}",
    "get loaded program": lambda d, _: f"Loaded program: {d.program}" if d.program else "No program loaded",
    "play": lambda d, _: d.play(),
    "stop": lambda d, _: d.stop(),
    "pause": lambda d, _: d.pause(),
    "unlock protective stop": lambda d, _: d.unlock(),
    "power on": lambda d, _: d.power(RobotMode.IDLE, "Powering on"),
    "power off": lambda d, _: d.power(RobotMode.POWER_OFF, "Powering off"),
    "brake release": lambda d, _: d.power(RobotMode.RUNNING, "Brake releasing"),
    "close popup": _said("closing popup"),
    "close safety popup": _said("closing safety popup"),
    "restart safety": _said("Restarting safety"),
    "clear operational mode": _said(
        "No longer controlling the operational mode. Current operational mode: 'NONE'"
    ),
    "getUserRole": lambda d, _: d.user_role,
    "saveLog": _said("Log saved to disk"),
    "quit": _said("Disconnected"),
    "shutdown": _said("Shutting down"),
}
_WITH_ARGUMENT: dict[str, Callable[[DashboardServer, str], str]] = {
    "load installation ": lambda _, name: f"Loading installation: {name}",
    "load ": lambda d, name: d.load(name),
    "popup": _said("showing popup"),
    "addToLog": _said("Added log message"),
    "setUserRole": lambda d, role: d.set_user_role(role),
    "set operational mode": lambda _, mode: f"Operational mode '{mode}' is set",
}


class LineReader:
    """Cuts what a client sends into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes; return the lines that are whole now. Raises `InputError` when one never ends."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            raise InputError(f"dashboard: a line of more than {LONGEST_LINE} bytes")
        return [line.decode("utf-8", errors="replace") for line in lines]
