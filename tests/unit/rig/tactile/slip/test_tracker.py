"""The tracker on a drawn contact: keyframes, long steps, gaps between frames, and bounded rotations."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.slip import keys, texture_stage, tracker
from rig.tactile.slip.alignment import Aligner
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.keys import Keyring
from rig.tactile.slip.loops import MOST_KEYS
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES, MOST_RATE_RAD_S
from rig.tactile.slip.search import MOST_REACH_RAD, MOST_TURN_RAD, is_texture_better
from rig.tactile.slip.texture_stage import TextureStage
from rig.tactile.slip.tracker import Contact, Tracked, Tracker
from support.drawn_sensor import drawn_press
from support.marks import heavy
from support.slip_frames import drawn, seen_at

PERIOD_S, REST = 1.0 / 30.0, 12
"""Frame period, s, and number of frames at rest in which a contact settles."""


class Followed:
    """A tracker that is shown drawn contacts."""

    def __init__(self) -> None:
        self.tracker, self.time_s = Tracker(learn_map), 0.0

    def show(
        self, turn_deg: float, after_s: float = PERIOD_S, seed: int = 0, torn: bool = False
    ) -> Tracked | None:
        """Return the fit of the next frame."""
        self.time_s += after_s
        return self.tracker.follow(seen_at(self.time_s, drawn(20.0 + turn_deg, seed=seed), torn), 0.0)

    def turned_deg(self, turn_deg: float, after_s: float = PERIOD_S) -> float:
        """Return the angle of the next frame, degrees."""
        tracked = self.show(turn_deg, after_s)
        return math.degrees(tracked.fit.angle_rad)

    @property
    def contact(self) -> Contact:
        contact = self.tracker.contact
        assert contact is not None
        return contact

    def key_angles_deg(self) -> list[float]:
        """Return the angles of the keyframes in the first reading."""
        return [math.degrees(key.angle_rad) for key in self.contact.search.readings[0].keys]


def rested() -> Followed:
    """Return a tracker with a settled contact."""
    followed = Followed()
    for frame in range(REST):
        followed.show(0.0, seed=frame)
    return followed


@pytest.mark.heavy
@given(
    start=st.floats(-10.0, 10.0),
    step=st.sampled_from([-1.0, 1.0]),
    size=st.floats(3.0, 25.0),
    gap_s=st.floats(0.2, 1.0),
)
@settings(max_examples=10)
def test_rotation_by_up_to_25_degrees_between_distant_frames_is_found(
    start: float, step: float, size: float, gap_s: float
) -> None:
    followed = rested()
    assert followed.turned_deg(start) == pytest.approx(start, abs=0.6)
    for turn in (start + step * size, start, start - step * size):
        assert followed.turned_deg(turn, gap_s) == pytest.approx(turn, abs=1.0)


@pytest.mark.heavy
@given(turns=st.lists(st.floats(-60.0, 60.0), min_size=2, max_size=8), period_s=st.floats(0.02, 0.4))
@settings(max_examples=10)
def test_fit_never_jumps_beyond_its_reach(turns: list[float], period_s: float) -> None:
    followed, since_s = rested(), 0.0
    for turn in turns:
        before = followed.contact.search.pose.angle_rad
        since_s += period_s
        tracked = followed.show(turn, period_s)
        reach = min(max(MOST_TURN_RAD, MOST_RATE_RAD_S * since_s), MOST_REACH_RAD)
        assert abs(followed.contact.search.pose.angle_rad - before) <= reach + 1e-9
        since_s = since_s if tracked is None else 0.0


@pytest.mark.heavy
def test_keyframes_are_added_while_turning_and_the_poorest_one_makes_room() -> None:
    followed, evicted = rested(), 0
    for turn in range(0, 150, 3):
        before = followed.contact.keyring.keys
        tracked = followed.show(float(turn))
        assert tracked is not None
        keys, readings = followed.contact.keyring.keys, followed.contact.search.readings
        assert len(keys) <= MOST_KEYS
        assert all(len(reading.keys) == len(keys) for reading in readings)
        kept = {id(key.source) for key in keys}
        gone = [key.richness for key in before if id(key.source) not in kept]
        assert gone in ([], [min(key.richness for key in before)])
        assert not gone or len(before) == MOST_KEYS
        evicted += len(gone)
    assert evicted
    assert max(followed.key_angles_deg()) > 147.0 - 2.0 * math.degrees(KEYFRAMES.further_rad)


def test_keyframe_gets_the_pose_of_its_own_frame_although_it_is_made_later() -> None:
    followed = rested()
    for _ in range(3):
        followed.show(0.0)
    before = len(followed.contact.keyring.keys)
    followed.contact.keyring.ask()
    asked = followed.turned_deg(4.0)
    assert len(followed.contact.keyring.keys) == before
    tracked = followed.show(9.0)
    assert tracked.rekeyed
    assert followed.key_angles_deg()[-1] == pytest.approx(asked, abs=0.3)


def test_loss_and_spread_before_the_keyframe_of_the_settled_contact_are_forgotten_with_it() -> None:
    followed = Followed()
    for frame in range(3):
        followed.show(0.0, seed=frame)
    followed.contact._worst_loss = followed.contact._worst_spread_rad = 5.0
    worst = [followed.show(0.0, seed=3 + frame) for frame in range(REST)]
    assert worst[0].worst_loss == 5.0
    assert worst[-1].worst_loss < 0.3
    assert worst[-1].worst_spread_rad < math.radians(1.0)


@given(
    gains=st.lists(st.floats(0.0, ALIGNMENT.more_score, exclude_max=True), min_size=1), leads=st.booleans()
)
def test_lead_does_not_change_while_neither_slopes_nor_texture_are_clearly_better(
    gains: list[float], leads: bool
) -> None:
    assert all(is_texture_better(gain, leads) is leads for gain in gains)
    assert is_texture_better(ALIGNMENT.more_score, leads)
    assert not is_texture_better(-0.01, leads)


def test_no_keyframe_is_made_of_torn_frames() -> None:
    followed = Followed()
    assert followed.show(0.0, torn=True) is None
    assert followed.tracker.contact is None
    followed = rested()
    followed.contact.keyring.ask()
    for frame in range(4):
        followed.show(0.0, seed=frame, torn=True)
        assert followed.contact.keyring._job is None


def test_contact_without_a_dent_is_answered_in_its_first_frame_only() -> None:
    flat = Tracker(lambda *_: None)
    answers = [flat.follow(seen_at(i * PERIOD_S, drawn(20.0, seed=i)), 0.0) for i in range(8)]
    assert [answer is not None for answer in answers] == [True] + [False] * 7


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the name of each long step."""
    taken: list[str] = []

    def record(of: Any, name: str) -> None:
        step = getattr(of, name)

        def recorded(*args: object) -> object:
            taken.append(name)
            return step(*args)

        monkeypatch.setattr(of, name, recorded)

    for of, names in (
        (tracker, ("make_keyframe",)),
        (keys, ("make_keyframe",)),
        (Keyring, ("_learn_map", "_change_map")),
        (TextureStage, ("_look",)),
        (texture_stage, ("noise_floor",)),
        (Aligner, ("coarse",)),
    ):
        for name in names:
            record(of, name)
    return taken


@pytest.mark.heavy
@pytest.mark.parametrize("turn_deg", [60.0, *heavy(-90.0)])
def test_no_frame_takes_two_long_steps(steps: list[str], blank: Image, turn_deg: float) -> None:
    """The first frame of a contact computes its texture, the second one its map and first keyframe."""
    estimator, before, seen = SlipEstimator(blank), 0, set[str]()
    for frame in range(150):
        turn = turn_deg * min(max(frame - 20, 0) / 100.0, 1.0)
        image = drawn_press(20.0 + turn, (80.0, 25.0 + 0.1 * min(frame, 60)), seed=frame)
        estimator.update(image, round(frame * NS_PER_S / 60.0))
        now, before = steps[before:], len(steps)
        seen |= set(now)
        assert frame == 0 or len(now) <= 1, (frame, now)
    assert {"make_keyframe", "_look", "noise_floor", "coarse"} <= seen
