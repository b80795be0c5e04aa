"""Leading the arm by hand: it yields only while the program polls it, and is held at rest at any end."""

import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError
from drivers.types import Vector6
from drivers.ur5e.arm import UR5e
from drivers.ur5e.status import from_ur, to_ur
from fakes.wire.ur.controller import URController
from support.marks import heavy, require_ur_rtde
from support.slow_motion import CLOCK, SLOWNESS, pause
from support.ur5e import make_arm, running, stands
from support.waiting import LIMIT_S, until
from support.worlds import HOME

pytestmark = pytest.mark.heavy

require_ur_rtde()
ASIDE: Vector6 = to_ur(HOME.translated(x_m=0.1, z_m=-0.15))

GUIDED = """
import sys, time
from drivers.clock import SystemClock
from drivers.types import Pose
from drivers.ur5e.arm import UR5e
from fakes.devices.arm import LIMITS
from protocols.teach import lead_by_hand
from rig.cli.common import stop_on_signals
from contextlib import nullcontext
from types import SimpleNamespace
stop_on_signals()
clock = SystemClock(int(sys.argv[2]))
arm = UR5e(sys.argv[1], LIMITS, Pose((0, 0, 0.28)), 2.5, (0, 0, 0.08), clock=clock)
arm.connect()
def there():
    if sys.argv[3] == "hangs":
        time.sleep(300)
    return False
operator = SimpleNamespace(guide=lambda question, where: nullcontext(there))
print("begins", flush=True)
try:
    lead_by_hand(SimpleNamespace(arm=arm, clock=clock), operator, "", None, float(sys.argv[4]))
except Exception as error:
    print(error, flush=True)
    print(arm.state().mode, flush=True)
arm.disconnect()
"""


@contextmanager
def guided(
    controller: URController, how: str = "looks", limit_s: float = 30.0
) -> Iterator["subprocess.Popen[str]"]:
    """A program that lets the arm be led, and a hand that pushes for a long time."""
    with running(GUIDED, controller, how, limit_s) as rig:
        until(lambda: controller.snapshot()["freedrive"])
        controller.guide(ASIDE, 6.0)
        yield rig


def place(controller: URController) -> np.ndarray:
    return np.array(controller.snapshot()["tcp_m"])


def test_guided_arm_stays_where_it_was_led(controller: URController, arm: UR5e) -> None:
    controller.guide(ASIDE, 0.5)
    pause(0.7)
    assert np.allclose(place(controller), HOME.position_m, atol=1e-6), "in position control it gives no way"
    arm.begin_guiding()
    controller.guide(ASIDE, 1.0)
    end_ns = CLOCK.now_ns() + to_ns(1.2)
    while CLOCK.now_ns() < end_ns:
        arm.state()
        pause(0.008)
    arm.end_guiding()
    assert np.allclose(arm.state().base_T_tcp.position_m, from_ur(ASIDE).position_m, atol=1e-4)
    controller.guide(to_ur(HOME), 0.3)
    pause(0.4)
    assert np.allclose(place(controller), from_ur(ASIDE).position_m, atol=1e-4), "held"
    motion = arm.move_linear(HOME, 0.2, 1.0)
    motion.wait(5.0)
    assert np.allclose(place(controller), HOME.position_m, atol=1e-3)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGQUIT])
def test_signal_ends_guiding_with_the_arm_held_at_rest(
    controller: URController, number: signal.Signals
) -> None:
    with guided(controller) as rig:
        until(lambda: place(controller)[0] > HOME.position_m[0] + 0.005)
        rig.send_signal(number)
        until(lambda: not controller.snapshot()["freedrive"])
        assert stands(controller), "the hand still pushes"
        said = rig.stdout.read()
    assert "stopped by the operator" in said
    assert "ArmMode.RUNNING" in said


def test_guiding_ends_with_an_error_after_its_program_was_suspended(controller: URController) -> None:
    with guided(controller, limit_s=60.0) as rig:
        until(lambda: place(controller)[0] > HOME.position_m[0] + 0.005)
        rig.send_signal(signal.SIGSTOP)
        until(lambda: not controller.snapshot()["freedrive"])
        rig.send_signal(signal.SIGCONT)
        said, _ = rig.communicate(timeout=LIMIT_S)
        assert "guiding by hand had ended: its program was stopped by a signal" in said
        assert "ArmMode.RUNNING" in said
        assert stands(controller)


def test_guiding_ends_at_its_time_limit(controller: URController) -> None:
    with guided(controller, limit_s=2.0) as rig:
        said = rig.stdout.read()
        assert "no confirmation within 2 s" in said
        assert "ArmMode.RUNNING" in said
        assert not controller.snapshot()["freedrive"]
        assert stands(controller)


@pytest.mark.parametrize("how", ["hangs", *heavy("is killed")])
def test_guiding_ends_if_its_program_hangs_or_is_killed(controller: URController, how: str) -> None:
    with guided(controller, how) as rig:
        if how == "is killed":
            rig.kill()
        until(lambda: not controller.snapshot()["freedrive"], 3.0 * SLOWNESS)
        assert stands(controller)


def test_protective_stop_ends_guiding(controller: URController, arm: UR5e) -> None:
    arm.begin_guiding()
    controller.inject("protective_stop")
    until(lambda: not controller.snapshot()["freedrive"])
    with pytest.raises(DeviceError, match="protective stop"):
        arm.begin_guiding()
    arm.stop()
    assert stands(controller)


def test_guiding_is_rejected_if_the_payload_differs_from_the_bench_file(controller: URController) -> None:
    arm = make_arm(controller.host, payload_kg=1.0)
    arm.connect()
    with pytest.raises(DeviceError, match="payload"):
        arm.begin_guiding()
    assert not controller.snapshot()["freedrive"]
