"""Simulated pictures of contacts that turn."""

import numpy as np

from fakes.studio.turning_frames import turning_frames


def test_a_seed_gives_the_same_pictures_and_another_gives_others() -> None:
    one, again, other = (next(turning_frames(seed)) for seed in (3, 3, 4))
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.after, b.after)
    assert not np.array_equal(one[0].image, other[0].image)
