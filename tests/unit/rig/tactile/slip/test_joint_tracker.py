"""The joint tracker: its keyframes, and a line that turns on a bulge of gel that rests."""

import math

import cv2
import numpy as np
import pytest

from rig.tactile.contact.gate import ContactGate
from rig.tactile.slip.channel import MOST_KEYS
from rig.tactile.slip.following import SeenContact, TextureOnDemand
from rig.tactile.slip.fused_angle import JointAngle
from rig.tactile.slip.height import Field
from rig.tactile.slip.joint_keys import RichKeyframes
from rig.tactile.slip.joint_tracker import JointTracker
from rig.tactile.slip.loops import values_at
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField, make_texture_key, richness

HEIGHT, WIDTH = 160, 120
FULL = np.ones((80, 60), np.uint8)
PERIOD_NS = 40_000_000


def fine_difference(angle_deg: float, strength: float = 1.0, seed: int = 0) -> Field:
    """A bulge that rests, and on it a line with a hook that turns; with noise, (h, w, 3)."""
    x, y = np.meshgrid(np.arange(WIDTH) - WIDTH / 2 + 0.5, HEIGHT / 2 - 0.5 - np.arange(HEIGHT))
    dome = np.exp(-0.5 * ((x / 26.0) ** 2 + (y / 18.0) ** 2))
    towards = [x * math.cos(a) + y * math.sin(a) for a in (0.0, 2.1, 4.2)]
    bulge = np.stack([0.35 * dome * t / 20.0 for t in towards], axis=2)
    turn = math.radians(angle_deg)
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    line = np.exp(-0.5 * (across / 1.5) ** 2) * (np.abs(along) < 30)
    hook = np.exp(-0.5 * ((along - 28) / 1.5) ** 2) * (np.abs(across - 6) < 8)
    noise = np.random.default_rng(seed).normal(0.0, 0.004, (HEIGHT, WIDTH, 3))
    return (bulge + 0.1 * strength * (line + hook)[..., None] + noise).astype(np.float32)


def seen(angle_deg: float, frame: int, strength: float = 1.0, torn: bool = False) -> SeenContact:
    fine = fine_difference(angle_deg, strength, frame)
    work = np.asarray(cv2.resize(fine, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA), np.float32)
    region = ContactGate().find(work)
    assert region is not None
    return SeenContact(work, TextureOnDemand(lambda: TextureField(fine, 2)), region, torn, frame * PERIOD_NS)


def followed(turns_deg: list[float]) -> list[JointAngle | None]:
    tracker = JointTracker()
    return [tracker.follow(seen(20.0 + turn, i)) for i, turn in enumerate(turns_deg)]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_line_that_turns_on_a_resting_bulge_is_followed_beyond_the_first_keyframe(way: float) -> None:
    turns = [0.0] * 3 + [way * 2.0 * i for i in range(30)]
    answers = followed(turns)
    assert answers[-1] is not None
    assert answers[2] is not None
    turned = math.degrees(answers[-1].angle_rad - answers[2].angle_rad)
    assert turned == pytest.approx(turns[-1], abs=1.5)
    assert answers[-1].score > 0.5


def test_keyframes_taken_between_frames_change_no_answer() -> None:
    at_once, between = JointTracker(), JointTracker()
    for i in range(24):
        expected, answer = (tracker.follow(seen(20.0 + 2.0 * i, i)) for tracker in (at_once, between))
        assert expected is not None
        assert answer is not None
        assert answer.angle_rad == expected.angle_rad
        assert answer.score == expected.score
        between.take_keyframe()


def test_no_keyframe_is_taken_from_a_torn_frame() -> None:
    assert JointTracker().follow(seen(20.0, 0, torn=True)) is None


def test_turn_beyond_the_motion_prior_is_not_reported() -> None:
    answers = followed([0.0, 0.0, 0.0, 80.0])
    assert answers[-1] is None or abs(math.degrees(answers[-1].angle_rad)) < 26.0


def test_richest_keyframes_are_kept() -> None:
    keys = RichKeyframes()
    for i, strength in enumerate([0.3, 0.4, 0.6, 0.8, 1.0, 1.2]):
        frame = seen(20.0, i, strength)
        assert keys.add(frame.difference, frame.texture(), frame.region.mask, 0.0, 30 + 40j) == 30 + 40j
    assert len(keys) == MOST_KEYS
    frame = seen(20.0, 5, 1.2)
    assert keys.richest == pytest.approx(richness(frame.texture(), frame.region.mask))


def test_poor_keyframes_are_not_aligned_to() -> None:
    keys, field = RichKeyframes(), GradientField(np.zeros((80, 60), np.complex64), FULL)
    for i, strength in enumerate([0.05, 1.5]):
        frame = seen(20.0, i, strength)
        keys.add(frame.difference, frame.texture(), frame.region.mask, math.radians(i), 30 + 40j)
    facing = keys.facing(field, seen(20.0, 2).texture())
    assert [key.angle_rad for key in facing] == [math.radians(1.0)]


def test_texture_counted_from_another_center_reads_the_same_pixels() -> None:
    field = TextureField(fine_difference(20.0), 2)
    key = make_texture_key(field, FULL, 30 + 40j)
    assert key is not None
    moved = key.counted_from(3.0 - 2.0j)
    channel, other = key.within(field, 30 + 40j), moved.within(field, 33.0 + 38.0j)
    assert values_at(other, 0.0, 0j) == pytest.approx(values_at(channel, 0.0, 0j), abs=1e-4)
    # A small turn about the new center: the jacobian predicts it as well as one about the old center.
    for one, place in ((key, channel), (moved, other)):
        turned = values_at(place, 0.004, 0j) - values_at(place, -0.004, 0j)
        predicted = -0.008 * one.jacobian[0]
        alike = float((turned * predicted).sum() / np.sqrt((turned**2).sum() * (predicted**2).sum()))
        assert abs(alike) > 0.85, "pixels are read by bilinear interpolation"
