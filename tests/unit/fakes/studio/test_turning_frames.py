"""Simulated pictures of contacts that turn."""

from itertools import islice

import numpy as np

from fakes.studio.turning_frames import turning_frames


def test_a_seed_gives_the_same_pictures_and_another_gives_others() -> None:
    one, again, other = (next(turning_frames(seed)) for seed in (3, 3, 4))
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.after, b.after)
    assert not np.array_equal(one[0].image, other[0].image)


def test_a_turn_changes_the_clean_picture_and_only_the_noisy_one_has_noise() -> None:
    for shown in (frames[0] for frames in islice(turning_frames(5), 6)):
        assert np.abs(shown.after - shown.before).max() > 1.0
        assert shown.before.shape == shown.image.shape
        seen = shown.image.astype(np.float32) - shown.background
        assert np.corrcoef(seen.ravel(), shown.before.ravel())[0, 1] > 0.5
