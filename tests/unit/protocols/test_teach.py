"""Teaching on a simulated bench, guided by hand or stepped by keys; the arm is held at any end of it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from drivers.errors import DeviceError, OperatorStopError
from drivers.types import Pose
from fakes.devices.arm import FakeArm
from protocols.operator import Operator
from protocols.teach import STEP_SPEED_M_S, lead_by_hand, step_by_keys
from rig.bench.assembly import build_bench
from rig.config import BenchConfig
from support.benches import NOISE_DEG, NOISE_M


@pytest.fixture
def made(light_bench: BenchConfig) -> Iterator[tuple[Bench, Operator]]:
    bench, operator = build_bench(light_bench)
    with bench.connection():
        yield bench, operator


@pytest.fixture
def bench(made: tuple[Bench, Operator]) -> Bench:
    return made[0]


class Person:
    """A person at the bench whose answers and actions the test sets."""

    def __init__(self, there: Callable[[], bool] = lambda: False, keys: str = "") -> None:
        self._there, self.keys, self.questions = there, list(keys), []

    @contextmanager
    def guide(self, question: str, where: Pose) -> Iterator[Callable[[], bool]]:
        yield self._there

    def key(self, question: str, where: Pose, here: Pose) -> str:
        self.questions.append(question)
        return self.keys.pop(0) if self.keys else "enter"


def moves_when_pushed(bench: Bench) -> bool:
    arm = bench.arm
    assert isinstance(arm, FakeArm)
    here = arm._world.tool.pose_at(bench.clock.now_ns())
    arm.lead(here.translated(x_m=0.05), 0.5)
    bench.clock.sleep_until(bench.clock.now_ns() + NS_PER_S)
    return arm._world.tool.pose_at(bench.clock.now_ns()) != here


def test_guided_arm_is_held_at_the_pose_it_was_led_to(made: tuple[Bench, Operator]) -> None:
    bench, operator = made
    where = bench.arm.state().base_T_tcp.translated(x_m=0.05, z_m=-0.1)
    there = lead_by_hand(bench, operator, "", where, 30.0)
    assert 0.0 < np.linalg.norm(np.subtract(there.position_m, where.position_m)) < 0.005, (
        "as well as hands do"
    )
    assert not moves_when_pushed(bench)


@pytest.mark.parametrize(
    ("raised", "limit_s", "said"),
    [
        (OperatorStopError("stopped by the operator"), 30.0, "stopped by the operator"),
        (DeviceError("something broke"), 30.0, "something broke"),
        (None, 0.5, "no confirmation within 0.5 s"),
    ],
)
def test_arm_is_held_however_guiding_ends(
    bench: Bench, raised: Exception | None, limit_s: float, said: str
) -> None:
    begun = []

    def there() -> bool:
        begun.append(moves_when_pushed(bench) if not begun and raised else True)
        if raised:
            raise raised
        return False

    with pytest.raises((OperatorStopError, DeviceError), match=said):
        lead_by_hand(bench, Person(there), "", bench.arm.state().base_T_tcp, limit_s)
    assert all(begun), "it gave way before"
    assert not moves_when_pushed(bench)


def test_each_key_is_one_bounded_step_at_low_speed(bench: Bench) -> None:
    home = bench.arm.state().base_T_tcp
    began_ns = bench.clock.now_ns()
    there = step_by_keys(bench, Person(keys="xxY3z1T?"), "question", home)
    assert np.allclose(np.subtract(there.position_m, home.position_m), (0.004, -0.002, 0.01), atol=NOISE_M)
    turn = (there.rotation * home.rotation.inv()).as_rotvec(degrees=True)
    assert np.allclose(turn, (0.0, 0.5, 0.0), atol=NOISE_DEG)
    assert (bench.clock.now_ns() - began_ns) / NS_PER_S >= 0.016 / STEP_SPEED_M_S


@pytest.mark.heavy
def test_step_beyond_the_limits_is_rejected_with_a_message(bench: Bench) -> None:
    home = bench.arm.state().base_T_tcp
    person = Person(keys="3" + "z" * 40)
    there = step_by_keys(bench, person, "question", home)
    assert home.position_m[2] + 0.2 < there.position_m[2] < bench.arm.limits.workspace_max_m[2]
    assert person.questions[0].startswith("question x y z step")
    assert person.questions[-1].startswith("refused: arm: ")


def test_stop_between_two_steps_leaves_the_arm_at_rest(bench: Bench) -> None:
    class Leaves(Person):
        def key(self, question: str, where: Pose, here: Pose) -> str:
            if not self.keys:
                raise OperatorStopError("q")
            return super().key(question, where, here)

    with pytest.raises(OperatorStopError) as stopped:
        step_by_keys(bench, Leaves(keys="x"), "", bench.arm.state().base_T_tcp)
    assert "stopped where it was" in str(stopped.value.__notes__)
    assert not moves_when_pushed(bench)
