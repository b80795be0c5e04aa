"""A bench is simulated only if running fakes confirm each of its devices; otherwise it is real."""

from collections.abc import Iterator
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.errors import InputError
from fakes.wire.net import ControlServer
from rig.bench.fakes_process import simulated_operator
from rig.bench.identity import prove_simulated
from rig.bench.operators import ConsoleOperator
from rig.bench.source import session_bench, unconnected_bench
from rig.config import BenchConfig, load_bench

SERVED: dict[str, Any] = {
    "arm": "127.0.0.9", "gripper": ["127.0.0.9", 40502],
    "SIM-D0001": "http://127.0.0.9:40001/stream.mjpg", "SIM-D0002": "http://127.0.0.9:40002/stream.mjpg",
    "SIM-C0001": "http://127.0.0.9:40003/stream.mjpg",
}  # fmt: skip
FAR = "192.0.2.10"


@pytest.fixture
def control() -> Iterator[ControlServer]:
    """The side channel of fakes with these devices; there are no servers at their addresses."""
    server = ControlServer({"identity": lambda: SERVED, "place": lambda object, seed: None})
    server.start()
    yield server
    server.stop()


def bench(control: str | None, **changed: Any) -> BenchConfig:
    """A bench file as `rig fakes serve --write` creates it, with changes."""
    values = load_bench("wire").model_dump()
    served = SERVED | changed
    values["fakes"] = {"control": control}
    values["arm"]["host"] = served["arm"]
    values["gripper"]["host"], values["gripper"]["port"] = served["gripper"]
    for sensor in (*values["tactile"], values["camera"]):
        sensor["address"] = served[sensor["serial"]]
    return BenchConfig.model_validate(values)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"arm": FAR}, f"arm at {FAR} is not on this computer"),
        ({"arm": "robot.lab"}, "arm at robot.lab is not on this computer"),
        ({"arm": "127.0.0.1"}, "arm at 127.0.0.1 is not one of the fakes"),
        ({"gripper": [FAR, 502]}, "gripper at"),
        ({"gripper": ["127.0.0.9", 502]}, "gripper at"),
        ({"SIM-D0001": "/dev/video0"}, "SIM-D0001 at /dev/video0"),
        ({"SIM-D0002": None}, "SIM-D0002 at None"),
        ({"SIM-C0001": f"http://{FAR}/stream.mjpg"}, "SIM-C0001 at"),
    ],
)
def test_one_unconfirmed_device_makes_the_bench_real_and_its_fakes_an_error(
    control: ControlServer, changed: dict[str, Any], named: str
) -> None:
    person = ConsoleOperator(lambda _: pytest.fail("no question may be asked"), agreed=True)
    config = bench(control.address, **changed)
    with pytest.raises(InputError, match=named), session_bench(config, person, "Begin?"):
        pass
    with pytest.raises(InputError, match=named), unconnected_bench(config):
        pass


def test_bench_is_simulated_as_long_as_its_fakes_confirm_every_device(control: ControlServer) -> None:
    config = bench(control.address)
    prove_simulated(config)
    operator = simulated_operator(config, SystemClock(), seed=0)
    operator.confirm("Activate it now?")
    operator.look("Anything?")
    operator.place("t1", "wrench")
    control.stop()
    for ask in (operator.confirm, operator.look, operator.nudge):
        with pytest.raises(InputError, match="no answer"):
            ask("Activate it now?")
    with pytest.raises(InputError, match="no answer"):
        operator.place("t1", "wrench")
    person = ConsoleOperator(lambda _: True)
    with pytest.raises(InputError, match="real bench"), session_bench(config, person, "Begin?"):
        pass


def test_bench_is_not_simulated_by_other_fakes_or_with_a_serial_line(control: ControlServer) -> None:
    values = bench(control.address).model_dump()
    serial_line = {"transport": "rtu", "device": "/dev/ttyUSB0", "preset": "rtu"}
    values["gripper"] = {"driver": "robotiq_3f", "fingers": ("B", "C"), **serial_line}
    for config, said in (
        (bench(f"{FAR}:5000"), "not on this computer"), (bench(None), "no side channel"),
        (BenchConfig.model_validate(values), "gripper at /dev/ttyUSB0 is not one of the fakes"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            prove_simulated(config)
