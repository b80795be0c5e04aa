"""Visiting poses: still before a picture, stopped on an error, limits before motion."""

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, OperatorStopError
from drivers.types import Frame, Pose
from protocols.capture_hand_eye import SETTLE_S, HandEyeCapture, capture_hand_eye, wait_until_still
from rig.bench.assembly import build_bench
from rig.config import load_bench
from support.benches import NOISE_M

TURN = (1.0, 0.0, 0.0, 0.0)
PLACES = {"a": (0.45, 0.0, 0.25), "b": (0.45, 0.05, 0.22), "far": (3.0, 0.0, 0.2), "c": (0.40, 0.0, 0.25)}


def visit(stop_after: int | None = None) -> tuple[list[HandEyeCapture], list[tuple[str, str]], bool]:
    bench, _ = build_bench(load_bench("fake"))
    taken: list[HandEyeCapture] = []
    skipped: list[tuple[str, str]] = []
    left = [(name, Pose(place, TURN)) for name, place in PLACES.items()]

    def keep(capture: HandEyeCapture) -> None:
        taken.append(capture)
        if len(taken) == stop_after:
            bench.arm.move_linear(Pose(PLACES["b"], TURN), 0.05, 0.5)
            raise OperatorStopError("stopped")

    with bench.connected():
        try:
            capture_hand_eye(
                bench, lambda: left.pop(0) if left else None, keep, lambda *why: skipped.append(why)
            )
        except OperatorStopError:
            before = bench.arm.state().base_T_tcp.position_m
            bench.clock.sleep_until(bench.clock.now_ns() + 500_000_000)
            after = bench.arm.state().base_T_tcp.position_m
            return taken, skipped, after == pytest.approx(before, abs=2 * NOISE_M)
    return taken, skipped, True


def test_every_reachable_pose_is_a_sample_under_its_own_id() -> None:
    taken, skipped, _ = visit()
    assert [capture.id for capture in taken] == ["a", "b", "c"]
    for capture in taken:
        assert capture.base_T_tcp.position_m == pytest.approx(PLACES[capture.id], abs=NOISE_M)
    assert [name for name, _ in skipped] == ["far"]
    assert "workspace" in skipped[0][1]


def test_noise_of_an_arm_at_rest_is_no_motion() -> None:
    bench, _ = build_bench(load_bench("fake"))
    far = Pose((0.70, 0.20, 0.15), TURN)
    with bench.connected():
        bench.arm.move_linear(far, 0.25, 1.0).wait(10.0)
        began_ns = bench.clock.now_ns()
        for _ in range(300):
            wait_until_still(bench)
        assert bench.clock.now_ns() - began_ns == 300 * to_ns(SETTLE_S), "still at the first comparison"


def test_stop_leaves_the_arm_at_rest() -> None:
    taken, _, standing = visit(stop_after=2)
    assert (len(taken), standing) == (2, True)


def test_lost_arm_ends_the_visit() -> None:
    config = load_bench("fake")
    fault = {"device": "arm", "kind": "disconnect", "at_s": 0.0}
    broken = config.model_validate({**config.model_dump(), "faults": [fault]})
    bench, _ = build_bench(broken)
    with bench.connected(), pytest.raises(DeviceError):
        capture_hand_eye(bench, lambda: ("a", Pose(PLACES["a"], TURN)), lambda _: None, lambda *_: None)


def test_lagging_stream_gives_no_image_of_the_motion() -> None:
    bench, _ = build_bench(load_bench("fake"))
    moved: list[int] = []

    def keeps_its_backlog(_: float) -> Frame:
        moved.append(bench.clock.now_ns())
        return bench.camera.next_frame(1.0)

    with bench.connected():
        left = [(name, Pose(PLACES[name], TURN)) for name in "ab"]
        bench.camera.newest_frame = keeps_its_backlog
        taken: list[HandEyeCapture] = []
        capture_hand_eye(bench, lambda: left.pop(0) if left else None, taken.append, lambda *_: None)
    assert len(taken) == 2
    assert all(one.frame.time_ns >= at for one, at in zip(taken, moved, strict=True))
