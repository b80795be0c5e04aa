"""Run simulated devices over the wire protocol for a bench file, in this process or in a child process."""

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.clock import Clock, to_ns
from drivers.errors import DeviceError, InputError, RigError
from drivers.realtime import realtime
from drivers.types import Pose
from fakes.wire.host.host import Addresses, FakesHost, WirePlan
from fakes.wire.net import Control, free_address, require_free
from fakes.wire.ur.controller import POLYSCOPE
from rig.bench.assembly import LED_S, simulated_bench_plan
from rig.bench.identity import prove_simulated
from rig.bench.operators import SimulatedOperator
from rig.bench.twins import laid_as
from rig.config import BenchConfig
from rig.config.devices import RobotiqConfig, RobotiqRtuConfig

START_S = 150.0
"""Time limit for the start of the simulated devices: longer than a loaded host takes."""
CHECK_S = 0.5
"""Interval at which the fakes' process checks that all its parts are alive."""
STOP_S = 10.0
"""Time limit for their end."""
LED_LATER_S = 0.1
"""Extra time after a guided motion until the simulated person reports its end, s."""
_SHOWN = (
    "robot_mode", "safety_mode", "remote_control", "program_running", "requests", "replies", "served",
    "missed", "withheld", "clients", "faults",
)  # fmt: skip
"""Values of each fake that are printed."""


@contextmanager
def hosted_fakes(
    config: BenchConfig, host: str | None, seed: int = 0, polyscope: str = POLYSCOPE, slowness: int = 1
) -> Iterator[tuple[BenchConfig, FakesHost]]:
    """Run the fakes of a bench file in this process; yield the file's bench with their addresses.

    They run at real-time priority if permitted, because they replace hardware, which a loaded host does not
    delay. host: a loopback address; None selects a free one. polyscope: the version that the simulated
    controller reports. slowness: of the devices' clock (`drivers.clock.SystemClock`). Raises `InputError` for
    a bench file without [fakes], an address in use, and an invalid version.
    """
    if config.fakes is None:
        raise InputError(f"bench '{config.name}' has no [fakes]: its devices are not simulated over the wire")
    host = host or free_address()
    require_free(host)
    with tempfile.TemporaryDirectory(prefix="rig-fakes-") as folder, realtime():
        gripper = config.require("gripper")
        rtu = str(Path(folder) / "gripper") if isinstance(gripper, RobotiqRtuConfig) else None
        preset = gripper.preset if isinstance(gripper, RobotiqConfig | RobotiqRtuConfig) else "tcp"
        wire = WirePlan(polyscope, gripper.fingers, preset, rtu)
        fakes = FakesHost(simulated_bench_plan(config), wire, host, seed, slowness)
        try:
            yield with_addresses(config, fakes.start()), fakes
        finally:
            fakes.stop()


@contextmanager
def started_fakes(config: BenchConfig, slowness: int = 1) -> Iterator[BenchConfig]:
    """Run the fakes of a bench file in a child process; yield the bench with their addresses.

    slowness: as in `hosted_fakes`. The child process ends with this one, however this one ends. Raises
    `DeviceError` if it does not start.
    """
    context = spawn_context()
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(config, theirs, slowness), name="fakes")
    process.start()
    theirs.close()
    try:
        try:
            answer: Any = ours.recv() if ours.poll(START_S) else None
        except (EOFError, OSError):
            answer = None
        if isinstance(answer, RigError):
            raise answer
        if answer is None:
            raise DeviceError("fakes: their process did not start; run 'rig fakes serve' to see why")
        yield answer
    finally:
        ours.close()
        process.join(STOP_S)
        if process.is_alive():
            process.kill()
            process.join()


def with_addresses(config: BenchConfig, where: Addresses) -> BenchConfig:
    """Return a bench with the addresses of running fakes filled in."""
    values = config.model_dump()
    values["fakes"] = {"control": where.control}
    values["arm"]["host"] = where.arm
    if isinstance(where.gripper, str):
        values["gripper"]["device"] = where.gripper
    else:
        values["gripper"]["host"], values["gripper"]["port"] = where.gripper
    for sensor in (*values["tactile"], values["camera"]):
        sensor["address"] = where.streams[sensor["serial"]]
    return BenchConfig.model_validate({**values, "calibrations": config.calibrations})


def fakes_control(config: BenchConfig) -> Control:
    """Return the side channel of a bench's running fakes. Raises `InputError` if it has none."""
    if config.fakes is None or config.fakes.control is None:
        raise InputError(
            f"bench '{config.name}' names no running fakes: start them with 'rig fakes serve --write FILE' "
            "and give that FILE"
        )
    return Control(config.fakes.control)


def simulated_operator(config: BenchConfig, clock: Clock, seed: int) -> SimulatedOperator:
    """Return the simulated operator of a bench of running fakes. clock: the bench's. seed: of the objects."""
    control = fakes_control(config)

    def place(object_id: str) -> None:
        control.call("place", object=laid_as(config.objects, object_id), seed=seed)

    def lead(to: Pose) -> Callable[[], bool]:
        turn = [float(v) for v in to.rotation.as_rotvec()]
        control.call("guide", to=[*to.position_m, *turn], over_s=LED_S)
        there_ns = clock.now_ns() + to_ns(LED_S + LED_LATER_S)
        return lambda: clock.now_ns() >= there_ns

    prove = partial(prove_simulated, config)
    return SimulatedOperator(place, lambda: tuple(control.call("gap")["gap_m"]), lead, seed, prove)


def state_lines(state: Mapping[str, Any]) -> list[str]:
    """Return the state of the simulated world as printable lines, with what each device has served."""
    x, y, z = state["tool_m"]
    held = f"held with {state['force_n']:.2f} N" if state["held"] else "not held"
    turned = f"turned {state['turn_deg']:+.1f} deg"
    lines = [
        f"tool at ({x:.3f}, {y:.3f}, {z:.3f}) m, {'moving' if state['tool_moving'] else 'at rest'}",
        f"fingers at {state['finger_counts']:.0f} counts",
        "no object" if state["object"] is None else f"object {state['object']}, {held}, {turned}",
    ]
    for name, counted in state["devices"].items():
        words = []
        for key in (key for key in _SHOWN if key in counted):
            value = counted[key]
            if isinstance(value, bool):
                value = "yes" if value else "no"
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            words.append(f"{key.replace('_', ' ')} {value}")
        lines.append(f"{name}: {', '.join(words)}")
    return lines


def _serve(config: BenchConfig, pipe: Connection, slowness: int) -> None:
    """Run in the fakes' process until the parent closes the pipe or has ended."""
    leave_signals_to_parent()
    try:
        hosted = hosted_fakes(config, host=None, slowness=slowness)
        with hosted as (served, fakes), suppress(EOFError, OSError):
            pipe.send(served)
            while not pipe.poll(CHECK_S):
                fakes.check()
    except RigError as error:
        print(f"rig: {error}", file=sys.stderr, flush=True)
        with suppress(OSError):
            pipe.send(error)
