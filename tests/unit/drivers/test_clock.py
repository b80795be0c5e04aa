"""A slowed clock lengthens every time limit of a bench. It is for tests: no real device accepts it."""

import ast
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from drivers.clock import NS_PER_S, SystemClock, host_s
from drivers.errors import InputError
from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link
from drivers.types import Pose
from drivers.ur5e.arm import UR5e
from drivers.video.digit import Digit
from drivers.video.external_camera import ExternalCamera
from fakes.clock import SharedClock, SimulatedClock
from fakes.devices.arm import LIMITS
from rig.bench.assembly import build_real_bench
from rig.config.load import parse_bench
from support.benches import real_bench

ROOT = Path(__file__).resolve().parents[3]
SLOW = SystemClock(4)
REFUSED = "a slowed clock lengthens all safety time limits"


def arm(host: str) -> UR5e:
    return UR5e(host, LIMITS, Pose((0.0, 0.0, 0.28)), 2.5, (0.0, 0.0, 0.08), clock=SLOW)


def test_slowed_clock_advances_and_waits_by_its_slowness() -> None:
    host, slow = SystemClock(), SystemClock(20)
    began_ns, began_host_ns = slow.now_ns(), host.now_ns()
    slow.sleep_until(began_ns + NS_PER_S // 200)
    assert slow.now_ns() >= began_ns + NS_PER_S // 200
    assert host.now_ns() - began_host_ns >= 19 * NS_PER_S // 200
    assert host_s(slow, 0.5) == 10.0
    assert host_s(SharedClock.start(20), 0.5) == 10.0
    assert host_s(host, 0.5) == host_s(SimulatedClock(realtime=True), 0.5) == 0.5


def digit(host: str) -> Digit:
    return Digit("D1", 60.0, address=f"http://[{host}]/s" if ":" in host else f"http://{host}/s", clock=SLOW)


NETWORKED = (arm, lambda host: Robotiq3F(tcp_link(host), clock=SLOW), digit)
LOCAL = (
    lambda: Robotiq3F(rtu_link("/dev/ttyUSB0"), clock=SLOW),
    lambda: Digit("D1", 60.0, clock=SLOW),
    lambda: ExternalCamera("C1", "/dev/video0", 30.0, (640, 480), clock=SLOW),
)


@pytest.mark.parametrize("host", ["192.168.0.2", "10.0.0.5", "ur5e.lab", "localhost", "0.0.0.0", "::2", ""])
def test_slowed_clock_is_rejected_by_every_driver_of_a_device_that_may_be_real(host: str) -> None:
    for make in (*(partial(make, host) for make in NETWORKED if host or make is not digit), *LOCAL):
        with pytest.raises(InputError, match=REFUSED):
            make()
    for make in NETWORKED:
        make("127.0.0.7")


@pytest.mark.parametrize("process", ["control 192.168.0.2 4 5 4 3", "state 192.168.0.2 3 4 4 500.0 1"])
def test_slowed_clock_is_rejected_by_the_processes_of_a_real_arm(process: str) -> None:
    command = [sys.executable, "-m", "drivers.ur5e.processes", *process.split()]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert REFUSED in done.stderr


def test_real_bench_has_the_full_speed_whatever_its_file_and_the_environment_contain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("SLOWNESS", "RIG_SLOWNESS", "RIG_CLOCK_SLOWNESS"):
        monkeypatch.setenv(name, "4")
    config = parse_bench(real_bench(), "bench.toml")
    clock = build_real_bench(config).clock
    assert isinstance(clock, SystemClock)
    assert clock.slowness == 1
    text = real_bench()
    for section in ("", "[arm]", "[gripper]", "[camera]"):
        slowed = text.replace(section, f"{section}\nslowness = 4\n", 1)
        with pytest.raises(InputError, match="slowness"):
            parse_bench(slowed, "bench.toml")
    with pytest.raises(InputError, match=REFUSED):
        build_real_bench(config, clock=SLOW)


PASSING_ON = {
    "drivers/ur5e/arm.py", "drivers/ur5e/processes.py", "fakes/clock.py", "fakes/wire/mjpeg/server.py",
}  # fmt: skip
"""Files that pass on the slowness of a given clock."""
MOST_WITHOUT = {"started_fakes": 1, "hosted_fakes": 4, "build_real_bench": 2}
"""Functions that take a slowness or a clock, and how many arguments come before it."""


def test_no_part_of_the_product_asks_for_a_slowed_clock() -> None:
    passing, asking = set(), set()
    for package in ("rig", "drivers", "fakes", "protocols", "calibration"):
        for path in (ROOT / package).rglob("*.py"):
            file, text = str(path.relative_to(ROOT)), path.read_text()
            if not any(name in text for name in ("SystemClock", "slowness", *MOST_WITHOUT)):
                continue
            for call in (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)):
                name = getattr(call.func, "id", getattr(call.func, "attr", ""))
                if name == "SystemClock" and (call.args or call.keywords):
                    passing.add(file)
                given = {word.arg: word.value for word in call.keywords}
                slowness = given.get("slowness")
                own = slowness is not None and not isinstance(slowness, ast.Name)
                more = len(call.args) > MOST_WITHOUT.get(name, len(call.args)) or "clock" in given
                if own or (name in MOST_WITHOUT and more):
                    asking.add(file)
    assert passing <= PASSING_ON
    assert asking == set()
