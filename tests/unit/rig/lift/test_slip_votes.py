"""What wrist and gripper say to a slip: each moves the angle it is told at, and no further than it may."""

import numpy as np
import pytest

from drivers.types import ArmMode, ArmState, GripperState, Pose
from rig.lift.fusion import TipAnswer
from rig.lift.slip_votes import VOTE_DEG, GripperVote, Votes, WristVote
from rig.lift.slip_watch import SlipSettings, SlipWatch
from rig.sessions.manifest import Voters
from rig.tactile.sample import SlipSample, State

CAMERA_NS = 33_000_000
NOISE_NM = 0.005


def wrist(time_ns: int, torque_nm: float, noise_nm: float = 0.0) -> ArmState:
    wrench = (0.0, 0.0, 0.0, 0.0, torque_nm + noise_nm, 0.0)
    return ArmState(time_ns, Pose((0.0, 0.0, 0.0)), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), wrench, ArmMode.RUNNING)


def fingers(time_ns: int, counts: int, moving: bool = False) -> GripperState:
    return GripperState(time_ns, True, moving, counts, 0, 0)


def lifted(torques_nm: list[float], seed: int = 0) -> tuple[WristVote, int]:
    """A wrist that rests, then carries these torques."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE_NM, 24 + len(torques_nm))
    vote = WristVote()
    for i, torque in enumerate([0.4] * 24 + [0.4 + t for t in torques_nm]):
        if i == 24:
            vote.begin()
        vote.arm(wrist(i * CAMERA_NS, torque, float(noise[i])))
    return vote, (23 + len(torques_nm)) * CAMERA_NS


@pytest.mark.parametrize("seed", range(5))
def test_a_torque_that_falls_speaks_for_a_slip(seed: int) -> None:
    vote, now_ns = lifted([0.1] * 10 + [0.06] * 3, seed)
    assert vote.moves_deg(now_ns) == -VOTE_DEG


@pytest.mark.parametrize("torques_nm", [[0.1] * 13, [0.01 * i for i in range(13)]])
def test_a_torque_that_stays_or_grows_says_nothing(torques_nm: list[float]) -> None:
    for seed in range(5):
        vote, now_ns = lifted(torques_nm, seed)
        assert vote.moves_deg(now_ns) == 0.0


def test_a_wrist_that_was_not_read_at_rest_says_nothing() -> None:
    vote = WristVote()
    vote.begin()
    for i, torque in enumerate([0.1] * 10 + [0.0] * 3):
        vote.arm(wrist(i * CAMERA_NS, torque))
    assert vote.moves_deg(12 * CAMERA_NS) == 0.0


def test_fingers_that_moved_speak_against_it_for_a_while() -> None:
    vote = GripperVote()
    assert vote.moves_deg(0) == 0.0
    for i, counts in enumerate([100, 100, 103, 106, 106]):
        vote.gripper(fingers(i * CAMERA_NS, counts))
    assert vote.moves_deg(4 * CAMERA_NS) == VOTE_DEG
    assert vote.moves_deg(3 * CAMERA_NS + 400_000_000) == 0.0


@pytest.mark.parametrize(
    ("voters", "names"),
    [("none", set()), ("wrist", {"wrist"}), ("gripper", {"gripper"}), ("both", {"wrist", "gripper"})],
)
def test_only_those_vote_who_may(voters: str, names: set[str]) -> None:
    assert set(Votes(Voters(voters)).cast(0)) == names


def told_at_deg(voters: Voters) -> tuple[float, dict[str, float]]:
    """From which angle on a slip is told while the fingers have just moved, and what was said to it."""
    rng = np.random.default_rng(0)
    made = SlipWatch(SlipSettings(votes=voters))
    rest = [(i, *rng.normal(0.0, (0.01, 0.3))) for i in range(50)]
    made.begin({"a": [answer(i, float(angle), float(rate)) for i, angle, rate in rest]})
    made.gripper(fingers(90 * 16_000_000, 100, moving=True))
    for i in range(100):
        made.update("a", answer(100, 0.01 * i, 10.0))
        if made.events:
            return 0.01 * i, dict(made.events[0].votes)
    raise AssertionError("never told")


def answer(frame: int, angle_deg: float, rate_deg_s: float) -> TipAnswer:
    sample = SlipSample(frame * 16_000_000, State.TRACKING, angle_deg, None, rate_deg_s=rate_deg_s)
    return TipAnswer(sample, angle_deg, None, rate_deg_s)


def test_a_vote_moves_the_angle_and_the_event_says_by_how_much() -> None:
    alone_deg, nothing = told_at_deg(Voters.NONE)
    voted_deg, votes = told_at_deg(Voters.GRIPPER)
    assert nothing == {}
    assert votes == {"gripper": VOTE_DEG}
    assert voted_deg == pytest.approx(alone_deg + VOTE_DEG, abs=0.011)
