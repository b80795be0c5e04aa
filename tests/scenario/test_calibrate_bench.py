"""Calibration protocols on a simulated bench with faults or a wrong tool; poses within limits.

`tests/cli/test_calibrate.py` collects and solves each kind of calibration.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.hand_eye.solve import Setup
from calibration.verdict import Verdict
from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceError, InputError, OperatorStopError, StaleFrameError
from drivers.types import ArmState, Frame, Pose
from fakes.devices.arm import FakeArm
from fakes.world.fixture import tip_m
from fakes.world.kinematics import TOOL_LENGTH_M
from fakes.world.motion import FingerPath, ToolPath
from fakes.world.state import BenchLayout
from fakes.world.world import World
from protocols.capture_hand_eye import (
    SETTLE_S,
    HandEyeCapture,
    capture_hand_eye,
    capture_still,
    wait_until_still,
)
from rig.bench.assembly import build_bench
from rig.bench.operators import ConsoleOperator
from rig.benchmark.wire.campaign import as_real
from rig.calibrate.bench import Station, grasp_at
from rig.calibrate.gripper import TipOptions, collect_tip
from rig.calibrate.hand_eye import HandEyeOptions, collect_hand_eye
from rig.calibrate.tactile import collect_references
from rig.config import BenchConfig, load_bench
from rig.config.write import write_bench
from support.benches import NOISE_M


def station(folder: Path, seed: int = 0, bench: BenchConfig | None = None) -> Station:
    person = ConsoleOperator(lambda _: False, True)
    return Station(bench or load_bench("fake"), seed, folder, person, lambda _: None)


@pytest.mark.heavy
@pytest.mark.parametrize(("wrong_m", "verdict"), [(0.03, Verdict.GOOD), (-0.06, Verdict.REFUSED)])
def test_calibrated_tip_does_not_depend_on_the_configured_tcp(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong_m: float, verdict: Verdict
) -> None:
    """An arm with a wrong TCP: reported and commanded poses of the tool are beside the real hand."""
    hand_T_tcp = Pose((0.0, 0.0, wrong_m), (0.0, 0.0, 1.0, 0.0))  # noqa: N806 - also turned about the tool's axis
    state, move = FakeArm.state, FakeArm.move_linear

    def wrong_state(self: FakeArm) -> ArmState:
        here = state(self)
        return replace(here, base_T_tcp=here.base_T_tcp @ hand_T_tcp)

    def wrong_move(self: FakeArm, base_T_tcp: Pose, *how: float) -> object:  # noqa: N803
        return move(self, base_T_tcp @ hand_T_tcp.inverse(), *how)

    monkeypatch.setattr(FakeArm, "state", wrong_state)
    monkeypatch.setattr(FakeArm, "move_linear", wrong_move)
    at = station(tmp_path, seed=3)
    tool = {"tcp_m": (0.0, 0.0, TOOL_LENGTH_M + wrong_m), "tcp_rotation_vector_rad": (0.0, 0.0, np.pi)}
    arm = at.config.arm.model_copy(update=tool)
    at = replace(at, config=at.config.model_copy(update={"arm": arm}))
    (found,) = collect_tip(at, TipOptions(poses=10))
    flange_to_tip_m = np.add((0.0, 0.0, TOOL_LENGTH_M), tip_m(3))
    assert found.value["translation_m"] == pytest.approx(flange_to_tip_m.tolist(), abs=5e-4)
    assert found.assessment.verdict is verdict


@pytest.mark.heavy
def test_hand_eye_of_a_camera_in_the_hand_is_found(tmp_path: Path) -> None:
    (found,) = collect_hand_eye(station(tmp_path), HandEyeOptions(setup=Setup.EYE_IN_HAND, poses=9))
    assert found.value["parent_frame"] == "tcp"
    assert np.allclose(found.value["translation_m"], (0.0121, -0.0616, -0.1074), atol=2e-3)


def test_unreadable_real_bench_is_an_error_and_keeps_earlier_samples(tmp_path: Path) -> None:
    values = load_bench("wire").model_dump()
    values["arm"]["host"] = values["gripper"]["host"] = "192.0.2.1"
    values["camera"]["address"] = "/dev/video9"
    path = tmp_path / "bench.toml"
    write_bench(path, as_real(BenchConfig.model_validate({**values, "name": "real"})))
    earlier = tmp_path / "tcp-samples" / "poses.csv"
    earlier.parent.mkdir()
    earlier.write_text("an afternoon's work")
    with pytest.raises(DeviceError, match="5 of 5 devices cannot be used, nothing was started"):
        collect_tip(station(tmp_path, bench=load_bench(str(path))), TipOptions(poses=4))
    assert earlier.read_text() == "an afternoon's work"


def test_grasp_off_the_middle_contacts_the_gels_off_the_middle() -> None:
    config = load_bench("fake")
    world = World(BenchLayout(Pose(config.table.position_m), grasp_at(config)), 0)
    world.lay("ball:10")
    world.tool = ToolPath.resting(grasp_at(config, 0.002, -0.003))
    world.fingers = FingerPath.resting(185.0)
    assert world.state_at(10_000_000).held
    assert world.grasp.off_m == pytest.approx((0.002, -0.003))
    with pytest.raises(InputError, match="1 to 150"):
        world.lay("ball:900")


TURN = (1.0, 0.0, 0.0, 0.0)
PLACES = {"a": (0.45, 0.0, 0.25), "b": (0.45, 0.05, 0.22), "far": (3.0, 0.0, 0.2), "c": (0.40, 0.0, 0.25)}


def visit(stop_after: int | None = None) -> tuple[list[HandEyeCapture], list[tuple[str, str]]]:
    """Visit the places, and stop during the move after a number of samples; the arm then stands still."""
    bench, _ = build_bench(load_bench("fake"))
    taken: list[HandEyeCapture] = []
    skipped: list[tuple[str, str]] = []
    left = [(name, Pose(place, TURN)) for name, place in PLACES.items()]

    def keep(capture: HandEyeCapture) -> None:
        taken.append(capture)
        if len(taken) == stop_after:
            bench.arm.move_linear(Pose(PLACES["b"], TURN), 0.05, 0.5)
            raise OperatorStopError("stopped")

    with bench.connection():
        try:
            capture_hand_eye(
                bench, lambda: left.pop(0) if left else None, keep, lambda *why: skipped.append(why)
            )
        except OperatorStopError:
            before = bench.arm.state().base_T_tcp.position_m
            bench.clock.sleep_until(bench.clock.now_ns() + 500_000_000)
            assert bench.arm.state().base_T_tcp.position_m == pytest.approx(before, abs=2 * NOISE_M)
    return taken, skipped


def test_every_reachable_pose_is_a_sample_under_its_own_id() -> None:
    taken, skipped = visit()
    assert [capture.id for capture in taken] == ["a", "b", "c"]
    for capture in taken:
        assert capture.base_T_tcp.position_m == pytest.approx(PLACES[capture.id], abs=NOISE_M)
    assert [name for name, _ in skipped] == ["far"]
    assert "workspace" in skipped[0][1]


def test_stop_leaves_the_arm_at_rest() -> None:
    assert len(visit(stop_after=2)[0]) == 2


def test_noise_of_an_arm_at_rest_is_no_motion() -> None:
    bench, _ = build_bench(load_bench("fake"))
    far = Pose((0.70, 0.20, 0.15), TURN)
    with bench.connection():
        bench.arm.move_linear(far, 0.25, 1.0).wait(10.0)
        began_ns = bench.clock.now_ns()
        for _ in range(300):
            wait_until_still(bench)
        assert bench.clock.now_ns() - began_ns == 300 * to_ns(SETTLE_S), "still at the first comparison"


def test_lost_arm_and_frozen_devices_end_a_calibration_with_their_reason(tmp_path: Path) -> None:
    def faulty(device: str, kind: str, at_s: float) -> BenchConfig:
        fault = {"device": device, "kind": kind, "at_s": at_s}
        config = load_bench("fake")
        return config.model_validate({**config.model_dump(), "faults": [fault]})

    taken: list[HandEyeCapture] = []

    def one_pose(bench: Bench) -> None:
        capture_hand_eye(bench, lambda: ("a", Pose(PLACES["a"], TURN)), taken.append, lambda *_: None)

    repeated = "SIM-C0001: it has repeated its picture"
    for device, kind, at_s, use, error, said in (
        ("arm", "disconnect", 0.0, one_pose, DeviceError, "arm"),
        ("SIM-C0001", "freeze", 0.3, one_pose, StaleFrameError, repeated),
        ("SIM-C0001", "freeze", 0.3, lambda b: capture_still(b, b.camera, 1), StaleFrameError, repeated),
        ("SIM-C0001", "freeze", 0.3, lambda b: capture_still(b, b.camera, 30), StaleFrameError, repeated),
    ):
        bench, _ = build_bench(faulty(device, kind, at_s))
        with bench.connection(), pytest.raises(error, match=said):
            use(bench)
    assert not taken
    with pytest.raises(StaleFrameError, match="SIM-D0002: it has repeated its picture"):
        collect_references(station(tmp_path, bench=faulty("SIM-D0002", "freeze", 0.3)))
    assert not list(tmp_path.glob("tactile-reference-SIM-D0002*"))


def test_lagging_stream_gives_no_image_of_the_motion() -> None:
    bench, _ = build_bench(load_bench("fake"))
    moved: list[int] = []

    def keeps_its_backlog(_: float) -> Frame:
        moved.append(bench.clock.now_ns())
        return bench.camera.next_frame(1.0)

    with bench.connection():
        left = [(name, Pose(PLACES[name], TURN)) for name in "ab"]
        bench.camera.newest_frame = keeps_its_backlog
        taken: list[HandEyeCapture] = []
        capture_hand_eye(bench, lambda: left.pop(0) if left else None, taken.append, lambda *_: None)
    assert len(taken) == 2
    assert all(one.frame.time_ns >= at for one, at in zip(taken, moved, strict=True))
