"""The dashboard server of the simulated controller: one line in, one line out, on port 29999.

Universal Robots, "Dashboard Server e-Series". The replies are worded as on that page.
"""

from collections.abc import Callable

from drivers.errors import InputError
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.runtime import RobotMode

BANNER = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE = 4096
_SINCE_5S = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)


def reply(robot: Robot, serial_number: str, line: str) -> str:
    """Answer one request to a controller with this serial number."""
    text = line.strip()
    if text.lower() == "get serial number":
        return serial_number
    answer = _REQUESTS.get(text.lower())
    return f'could not understand: "{text}"' if answer is None else answer(robot)


def _stop(robot: Robot) -> str:
    robot.end_program("stopped on the dashboard")
    return "Stopped"


def _unlock(robot: Robot) -> str:
    return "Protective stop releasing" if robot.safety.unlock(robot.time_ns) else _SINCE_5S


def _power(robot: Robot, mode: RobotMode, done: str) -> str:
    return done if robot.safety.power(mode) else "Failed: emergency stop"


_REQUESTS: dict[str, Callable[[Robot], str]] = {
    "polyscopeversion": lambda robot: "URSoftware {}.{}.{}.{} (Jun 30 2021)".format(*robot.version),
    "is in remote control": lambda robot: str(robot.safety.remote_control).lower(),
    "running": lambda robot: f"Program running: {str(robot.runtime.running).lower()}",
    "robotmode": lambda robot: f"Robotmode: {robot.safety.robot_mode.name}",
    "safetymode": lambda robot: f"Safetymode: {robot.safety.mode.name}",
    "stop": _stop,
    "unlock protective stop": _unlock,
    "power on": lambda robot: _power(robot, RobotMode.IDLE, "Powering on"),
    "brake release": lambda robot: _power(robot, RobotMode.RUNNING, "Brake releasing"),
    "close safety popup": lambda _: "closing safety popup",
    "quit": lambda _: "Disconnected",
}


class LineReader:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Add bytes, return the lines that are now complete. Raises `InputError` for a line without end."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            raise InputError(f"dashboard: a line of more than {LONGEST_LINE} bytes")
        return [line.decode("utf-8", errors="replace") for line in lines]
