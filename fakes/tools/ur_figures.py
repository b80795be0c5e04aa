"""How fast the simulated controller is, measured with the real client library.

    python -m fakes.tools.ur_figures [ADDRESS]

prints state samples and servoJ calls per second, the share of a core that the controller takes
with two clients at 500 Hz, and how soon a stop begins. Half a minute; needs ur-rtde.
"""

import json
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from scipy.spatial.transform import Rotation

from drivers.children import spawn_context
from drivers.clock import NS_PER_S, SystemClock, to_ns
from drivers.types import Pose
from fakes.clock import SharedClock
from fakes.wire.ur.controller import URController
from fakes.world.world import BenchLayout, World

DURATION_S = 5.0
HOST = "127.0.0.1"
_LOOK_S = 0.0003
_CLOCK = SystemClock()


def serve(host: str, version: str, pipe: Connection) -> None:
    """Run a controller until the other side hangs up; answer each message with a snapshot."""
    sys.setswitchinterval(0.0005)
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=0)
    controller = URController(world, SharedClock(_CLOCK.now_ns()), host, version)
    controller.start()
    pipe.send("ready")
    while pipe.recv():
        pipe.send(controller.snapshot())
    controller.stop()


def measure(host: str, snapshot: Callable[[], dict[str, Any]]) -> dict[str, float]:
    """All figures of a running controller."""
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    began = _CLOCK.now_ns()
    receive = RTDEReceiveInterface(host)
    connected = _CLOCK.now_ns()
    control = RTDEControlInterface(host)
    figures = {
        "receive_connects_s": (connected - began) / NS_PER_S,
        "control_connects_s": (_CLOCK.now_ns() - connected) / NS_PER_S,
    }
    before, at_ns = snapshot(), _CLOCK.now_ns()
    figures["samples_per_s"] = _samples_per_s(receive)
    figures["servo_calls_per_s"] = _servo_calls_per_s(receive, control)
    after = snapshot()
    share = (after["cpu_s"] - before["cpu_s"]) / ((_CLOCK.now_ns() - at_ns) / NS_PER_S)
    figures["controller_core_share"] = share
    figures["skipped_cycles"] = after["skipped_cycles"] - before["skipped_cycles"]
    control.servoStop()
    figures["stop_begins_s"] = _stop_begins_s(receive, control)
    return figures


def _samples_per_s(receive: Any) -> float:
    seen, end = set(), _CLOCK.now_ns() + to_ns(DURATION_S)
    while _CLOCK.now_ns() < end:
        seen.add(receive.getTimestamp())
        _CLOCK.sleep_until(_CLOCK.now_ns() + to_ns(_LOOK_S))
    return len(seen) / DURATION_S


def _servo_calls_per_s(receive: Any, control: Any) -> float:
    joints, calls = receive.getActualQ(), 0
    end = _CLOCK.now_ns() + to_ns(DURATION_S)
    while _CLOCK.now_ns() < end:
        cycle = control.initPeriod()
        joints[0] += 0.0002
        calls += control.servoJ(joints, 0.0, 0.0, 0.002, 0.1, 300)
        control.waitPeriod(cycle)
    return calls / DURATION_S


def _stop_begins_s(receive: Any, control: Any) -> float:
    """From the call of an asynchronous stopL to the first sample with a lower speed."""
    pose = receive.getActualTCPPose()
    pose[2] -= 0.2
    control.moveL(pose, 0.1, 1.0, True)
    _CLOCK.sleep_until(_CLOCK.now_ns() + to_ns(0.5))
    began = _CLOCK.now_ns()
    control.stopL(10.0, True)
    while abs(receive.getActualTCPSpeed()[2]) > 0.099 and _CLOCK.now_ns() - began < NS_PER_S:
        _CLOCK.sleep_until(_CLOCK.now_ns() + to_ns(_LOOK_S / 3))
    return (_CLOCK.now_ns() - began) / NS_PER_S


def main(host: str) -> None:
    """Measure both versions; print a JSON line for each."""
    for version in ("5.11.0", "5.25.0"):
        context = spawn_context()
        here, there = context.Pipe()
        process = context.Process(target=serve, args=(host, version, there))
        process.start()
        # So that waiting ends when the controller could not start: it has said why itself.
        there.close()
        try:
            here.recv()
        except EOFError:
            sys.exit(1)

        def snapshot(pipe: Connection = here) -> dict[str, Any]:
            pipe.send(True)
            return pipe.recv()

        figures = measure(host, snapshot)
        here.send(False)
        process.join()
        print(json.dumps({"version": version} | {name: round(v, 4) for name, v in figures.items()}))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else HOST)
