"""The dashboard server of the simulated controller: one line in, one line out, on port 29999.

Universal Robots, "Dashboard Server e-Series". The replies are worded as on that page.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import InputError
from fakes.wire.ur.robot import Robot
from fakes.wire.ur.safety import RobotMode
from fakes.wire.ur.script import OtherProgram

BANNER = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE = 4096
UNNAMED = "<unnamed>"
"""Name of a program that was uploaded, or of none."""
_SINCE_5S = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)


@dataclass(slots=True)
class DashboardServer:
    """Answers the requests of a client. start: runs a program on the robot."""

    robot: Robot
    serial_number: str
    start: Callable[[OtherProgram], bool]
    program: str = ""

    def reply(self, line: str) -> str:
        """Answer one request."""
        text = line.strip()
        for request, answer in _REQUESTS.items():
            if text.lower() == request.lower():
                return answer(self)
        if text.lower().startswith("load ") and text.endswith(".urp"):
            self.program = text[len("load ") :].strip()
            return f"Loading program: {self.program}"
        return f'could not understand: "{text}"'

    def state(self) -> str:
        """Return state and name of the program."""
        running = "PAUSED" if self.robot.paused else "PLAYING"
        return f"{running if self.robot.running else 'STOPPED'} {self.program or UNNAMED}"

    def unlock(self) -> str:
        """Release a protective stop, unless it is too early."""
        return "Protective stop releasing" if self.robot.safety.unlock(self.robot.time_ns) else _SINCE_5S

    def play(self) -> str:
        """Start the loaded program. It is not simulated: it runs until it is stopped, without motions."""
        if self.robot.paused:
            self.robot.paused = False
            return "Starting program"
        ready = self.program and self.robot.safety.remote_control
        if ready and self.start(OtherProgram(("sleep(3600)",))):
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

    def power(self, mode: RobotMode, reply: str) -> str:
        """Switch on, release the brakes, or switch off."""
        return reply if self.robot.safety.power(mode, self.robot.time_ns) else "Failed: emergency stop"


_REQUESTS: dict[str, Callable[[DashboardServer], str]] = {
    "PolyscopeVersion": lambda d: "URSoftware {}.{}.{}.{} (Jun 30 2021)".format(*d.robot.version),
    "get serial number": lambda d: d.serial_number,
    "get robot model": lambda _: "UR5",
    "is in remote control": lambda d: str(d.robot.safety.remote_control).lower(),
    "running": lambda d: f"Program running: {str(d.robot.running).lower()}",
    "robotmode": lambda d: f"Robotmode: {d.robot.safety.robot_mode.name}",
    "safetymode": lambda d: f"Safetymode: {d.robot.safety.mode.name}",
    "safetystatus": lambda d: f"Safetystatus: {d.robot.safety.mode.name}",
    "programState": DashboardServer.state,
    "play": DashboardServer.play,
    "stop": DashboardServer.stop,
    "pause": DashboardServer.pause,
    "unlock protective stop": DashboardServer.unlock,
    "power on": lambda d: d.power(RobotMode.IDLE, "Powering on"),
    "power off": lambda d: d.power(RobotMode.POWER_OFF, "Powering off"),
    "brake release": lambda d: d.power(RobotMode.RUNNING, "Brake releasing"),
    "close popup": lambda _: "closing popup",
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
