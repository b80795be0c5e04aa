"""The shipped network on frames unlike those it was trained on."""

from itertools import islice

import numpy as np

from fakes.studio.training_frames import hard_frames
from rig.benchmark.segmentation import FRAME_SIZE, HARD, HELD_OUT, LEAST_UNLIKE_DICE, score_examples
from rig.training.examples import examples_of


def test_shipped_network_finds_the_contacts_of_hard_lifts() -> None:
    examples = examples_of(hard_frames(HELD_OUT, 11), 60, FRAME_SIZE)
    score = score_examples("ours", "ours", HARD, examples)
    assert score.frames == 60
    assert score.dice.mean >= LEAST_UNLIKE_DICE


def test_hard_frames_are_the_same_for_a_seed() -> None:
    made = [examples_of(hard_frames(HELD_OUT, seed), 12, (60, 80)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(made[0].frames, made[1].frames)
    assert (made[0].frames != made[2].frames).any()


def test_frames_of_a_hard_lift_show_one_unit_and_one_object() -> None:
    for lift in islice(hard_frames(HELD_OUT, 5), 3):
        assert len({shown.object_id for shown in lift}) == 1
        assert all((shown.background == lift[0].background).all() for shown in lift)
        assert all(shown.touching is not None and shown.touching.any() for shown in lift)
