"""The faults of `rig benchmark faults`, device by device."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault. injected: (device, kind, arguments) in order.

    named: words of which the outcome has to contain one. mended_after: number of attempts that fail before a
    person mends it (a cable, a switch); a protective stop is left for the rig to recover from.
    """

    name: str
    injected: tuple[tuple[str, str, Mapping[str, Any]], ...]
    named: tuple[str, ...]
    mended_after: int = 1


def _case(name: str, device: str, kind: str, named: str, **arguments: Any) -> FaultCase:
    return FaultCase(name, ((device, kind, arguments),), (named,))


CASES = (
    _case("arm: protective stop", "arm", "protective_stop", "protective stop"),
    _case("arm: program killed", "arm", "program_killed", "program"),
    _case("arm: stream frozen", "arm", "stream_frozen", "arm"),
    _case("arm: stream repeats itself", "arm", "stream_frozen", "arm", repeat=True),
    _case("arm: sockets dropped", "arm", "socket_dropped", "arm"),
    _case("arm: silent peer", "arm", "silent", "arm"),
    FaultCase(
        "arm: remote control off, then reconnect",
        (("arm", "remote_control_off", {}), ("arm", "socket_dropped", {})),
        ("arm",),
        mended_after=2,
    ),
    FaultCase(
        "arm: recipe refused at reconnect",
        (("arm", "recipe_refused", {}), ("arm", "socket_dropped", {})),
        ("arm",),
        mended_after=2,
    ),
    _case("gripper: silent", "gripper", "silent", "gripper"),
    _case("gripper: connection closed", "gripper", "disconnect", "gripper"),
    _case("gripper: power lost", "gripper", "power_lost", "gripper"),
    _case("gripper: fault 0x0D", "gripper", "fault", "0x0D", code=0x0D),
    _case("gripper: fingers blocked", "gripper", "blocked", "gripper"),
    _case("gripper: fingers stuck, success reported", "gripper", "stuck", "gripper"),
    _case("gripper: success and position reported falsely", "gripper", "false_success", "gripper"),
    _case("gripper: fingers move too far", "gripper", "overshoot", "gripper"),
    _case("gripper: fingers drift open without a command", "gripper", "drift", "without a command"),
    _case("gripper: garbage", "gripper", "garbage", "gripper"),
    _case("fingertip: frozen", "SIM-D0001", "freeze", "SIM-D0001"),
    _case("fingertip: no frames", "SIM-D0001", "drop", "SIM-D0001"),
    _case("fingertip: unplugged", "SIM-D0002", "disconnect", "SIM-D0002"),
    _case("fingertip: green frames", "SIM-D0001", "green", "SIM-D0001"),
    _case("fingertip: shifted frames", "SIM-D0001", "shift", "SIM-D0001"),
    _case("fingertip: truncated frames", "SIM-D0001", "truncate", "SIM-D0001"),
    _case("camera: frozen", "camera", "freeze", "SIM-C0001"),
    _case("camera: unplugged", "camera", "disconnect", "SIM-C0001"),
)
