"""Shared parts of the served fakes: mirror, side channel, motion log, addresses, bench file."""

import math
import socket
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError
from fakes.objects.catalogue import find_object
from fakes.wire.gripper.server import GripperModel
from fakes.wire.host.host import Addresses
from fakes.wire.net import Control, ControlServer, require_free, taken_ports
from fakes.world.mirror import MirroredWorld, Track, snapshot_of
from fakes.world.world import World
from rig.bench.assembly import build_real_bench
from rig.bench.fakes_process import fakes_control, hosted_fakes, with_addresses
from rig.bench.twins import laid_as
from rig.config import BenchConfig, load_bench
from rig.config.load import parse_bench
from rig.config.objects import new_object_text, parse_object
from rig.config.write import bench_text
from support.finger_counts import opening_m
from support.worlds import lifting_world

PLAIN = laid_as([parse_object(new_object_text("lever"), "lever.toml")], "lever")
"""An object that only its file describes."""


@pytest.mark.parametrize("text", ["t1", PLAIN])
def test_mirrored_world_equals_the_world(text: str) -> None:
    world = lifting_world(text, seed=5)
    mirror = MirroredWorld(world.layout, snapshot_of(world, to_ns(1.0)))
    for step in range(1, 251):
        mirror.feed(snapshot_of(world, to_ns(1.0 + 0.004 * step)))
    assert (mirror.seed, mirror.variation) == (5, world.variation)
    assert mirror.grasp == world.grasp is not None
    for time_s in np.linspace(1.05, 1.95, 37):
        ours, theirs = mirror.state_at(to_ns(time_s)), world.state_at(to_ns(time_s))
        assert ours.held
        assert theirs.held
        assert ours.object_turn_rad == pytest.approx(theirs.object_turn_rad, abs=math.radians(0.1))
        here, there = mirror.object_pose_at(to_ns(time_s)), world.object_pose_at(to_ns(time_s))
        assert np.allclose(here.position_m, there.position_m, atol=2e-4)


@pytest.fixture
def control() -> Iterator[Control]:
    def place(object_id: str) -> dict[str, str]:
        return {"placed": find_object(object_id).name}

    server = ControlServer({"place": place})
    server.start()
    yield Control(server.address)
    server.stop()


def test_side_channel_executes_known_commands_and_rejects_others(control: Control) -> None:
    assert control.call("place", object_id="t1") == {"placed": "wrench"}
    with pytest.raises(InputError, match="unknown object 'wrnch'"):
        control.call("place", object_id="wrnch")
    with pytest.raises(InputError, match="commands are place"):
        control.call("explode")
    with pytest.raises(InputError, match="wrong arguments"):
        control.call("place", subject="t1")


RUBBISH: tuple[tuple[dict[str, Any], str], ...] = (
    ({"do": "place", "object": "charuco:8x6:25:18:DICT_5X5_99@tool"}, "no dictionary"),
    ({"do": "place", "object": "charuco:9999x9999:25:18:DICT_5X5_100@tool"}, "not valid"),
    ({"do": "place", "object": ["t1"]}, "id or a name"),
    ({"do": "place", "object": "t1", "seed": 1.5}, "whole number"),
    ({"do": "place", "object": "t1", "seed": -1}, "whole number"),
    ({"do": "place", "object": "t1", "seed": 10**400}, "whole number"),
    ({"do": "place", "object": "t1", "seed": True}, "whole number"),
    ({"do": "fault", "device": "arm", "kind": "silent", "duration_s": "x"}, "number from 0"),
    ({"do": "fault", "device": "arm", "kind": "silent", "duration_s": -1}, "number from 0"),
    ({"do": "fault", "device": ["arm"], "kind": "silent"}, "names"),
    ({"do": "fault", "device": "gripper", "kind": "delay", "delay_s": float("inf")}, "number from 0"),
    ({"do": "fault", "device": "SIM-D0001", "kind": "freeze", "duration_s": 1e308}, "number from 0"),
    ({"do": "fault", "device": "SIM-D0001", "kind": "drop", "frames": "x"}, "whole number"),
    ({"do": "fault", "device": "SIM-D0001", "kind": "drop", "x": 1}, "has no x"),
    ({"do": "fault", "device": "gripper", "kind": "silnt"}, r"gripper 'silnt' \(did you mean 'silent'\?\)"),
)


@pytest.mark.heavy
def test_invalid_side_channel_requests_disturb_nothing() -> None:
    with hosted_fakes(load_bench("wire"), host=None) as (served, fakes):
        control = fakes_control(served)
        for request, refusal in RUBBISH:
            with pytest.raises(InputError, match=refusal):
                control.call(request.pop("do"), **request)
        control.call("place", object="charuco:8x6:25:18:DICT_5X5_100@tool")
        with urllib.request.urlopen(served.camera.address, timeout=120) as stream:
            assert stream.read(7) == b"--frame"
        time.sleep(0.5)
        fakes.check()
        began = time.monotonic()
    assert time.monotonic() - began < 5.0


@pytest.mark.heavy
def test_failed_part_ends_the_fakes_with_its_reason() -> None:
    with hosted_fakes(load_bench("wire"), host=None) as (_, fakes):
        fakes._world.seed = 1.5  # type: ignore[assignment] - no sensor can be drawn with it
        with pytest.raises(DeviceError, match="fake cameras: TypeError: SeedSequence"):
            fakes.wait()
        began = time.monotonic()
    assert time.monotonic() - began < 10.0


def test_unreachable_side_channel_is_a_device_error() -> None:
    with pytest.raises(DeviceError, match="rig fakes serve"):
        Control("127.0.0.1:1").call("world")
    with pytest.raises(InputError, match="host:port"):
        Control("nowhere")
    with pytest.raises(InputError, match="names no running fakes"):
        fakes_control(load_bench("wire"))


def test_track_records_motions_from_start_to_standstill_only() -> None:
    track, step_ns = Track(), 4_000_000
    for step in range(300):
        x = 0.0005 * min(max(step - 50, 0), 100)
        track.see(step * step_ns, (x, 0.0, 0.0), 6.0, held=step >= 200)
        assert track.moving == (50 < step <= 150)
    steps = [sample[0] // step_ns for sample in track.since(0)]
    assert steps == [0, *range(50, 151), 199, 200, 299]
    assert [sample[5] for sample in track.since(0)][-3:] == [False, True, True]
    assert [sample[0] // step_ns for sample in track.since(149 * step_ns + 1)] == [149, 150, 199, 200, 299]


def test_only_free_loopback_addresses_are_served() -> None:
    with pytest.raises(InputError, match="no loopback address"):
        require_free("192.168.0.1")
    with socket.create_server(("127.0.0.77", 30003)):
        assert taken_ports("127.0.0.77") == [30003]
        with pytest.raises(InputError, match="--host"):
            require_free("127.0.0.77")
    require_free("127.0.0.77")


def test_a_bench_without_fakes_is_not_served() -> None:
    with pytest.raises(InputError, match=r"no \[fakes\]"), hosted_fakes(load_bench("fake"), "127.0.0.77"):
        pass


@pytest.mark.parametrize("transport", ["tcp", "rtu"])
def test_printed_bench_file_is_read_back_with_its_addresses(transport: str, tmp_path: Path) -> None:
    gripper = ("127.0.0.2", 40001) if transport == "tcp" else str(tmp_path / "gripper")
    config = _with_gripper(transport=transport)
    streams = {serial: f"http://127.0.0.2/{serial}" for serial in ("SIM-D0001", "SIM-D0002", "SIM-C0001")}
    served = with_addresses(config, Addresses("127.0.0.2", gripper, streams, "127.0.0.2:9"))
    again = parse_bench(bench_text(served), "served.toml")
    assert again == served
    assert again.arm.host == "127.0.0.2"
    assert again.camera.address == streams["SIM-C0001"]
    named = again.gripper.device if transport == "rtu" else (again.gripper.host, again.gripper.port)
    assert named == gripper
    assert again.simulated


@pytest.mark.heavy
@pytest.mark.parametrize(
    "gripper",
    [
        pytest.param({"fingers": ("A", "B")}, marks=pytest.mark.heavy),
        pytest.param({"fingers": ("C", "A"), "preset": "tcp-2014"}, marks=pytest.mark.heavy),
        {"fingers": ("A", "C"), "transport": "rtu"},
    ],
)
def test_gripper_is_served_as_configured_in_the_bench_file(
    gripper: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def soon_activated(
        world: World, now_ns: int, fingers: tuple[str, ...], activation_s: float
    ) -> GripperModel:
        return GripperModel(world, now_ns, fingers, activation_s=0.1)

    monkeypatch.setattr("fakes.wire.gripper.server.GripperModel", soon_activated)
    config = _with_gripper(**gripper)
    fingers = [{"finger": name} for name in config.gripper.fingers]
    tactile = tuple(t.model_copy(update=f) for t, f in zip(config.tactile, fingers, strict=True))
    config = config.model_copy(update={"tactile": tactile})
    with hosted_fakes(config, host=None, polyscope="5.25.0") as (served, _):
        driver = build_real_bench(served).gripper
        driver.connect()
        try:
            driver.activate()
            driver.move_to(opening_m(driver, 100)).wait(5.0)
            status = Control(served.fakes.control).call("status")  # type: ignore[union-attr]
        finally:
            driver.disconnect()
    assert status["finger_counts"] == pytest.approx(100.0)
    assert status["devices"]["arm"]["version"] == "5.25.0"


def test_invalid_version_string_is_rejected() -> None:
    with (
        pytest.raises(InputError, match="is written as"),
        hosted_fakes(load_bench("wire"), host=None, polyscope="latest"),
    ):
        pass


def _with_gripper(**changes: Any) -> BenchConfig:
    gripper = {"driver": "robotiq_3f", "fingers": ("B", "C"), **changes}
    return BenchConfig.model_validate({**load_bench("wire").model_dump(), "gripper": gripper})
