"""The imprint of a contact, and how much of it remains after a release, in any light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.types import Image
from protocols.pump import LEFT_SHARE, Imprint, imprint, share_left

SIZE = (320, 240, 3)


def gel(contact: float = 0.0, light: float = 1.0, drift: float = 0.0, seed: int = 0) -> Image:
    """A gel with noise, a bar-shaped contact, light of some strength, and drifting light across the frame."""
    rng = np.random.default_rng(seed)
    image = rng.normal(110.0, 2.0, SIZE)
    image[140:170, 80:160] += 60.0 * contact
    image *= light * (1.0 + drift * np.linspace(-1.0, 1.0, SIZE[1])[None, :, None])
    return np.clip(image, 0, 255).astype(np.uint8)


def untouched() -> Imprint:
    return np.mean([imprint(gel(seed=seed)) for seed in range(1, 9)], axis=0)


@pytest.mark.slow
@given(
    light=st.floats(0.7, 1.3),
    drift=st.floats(-0.2, 0.2),
    strength=st.floats(0.2, 1.0),
    seed=st.integers(9, 99),
)
def test_release_is_detected_in_any_light(light: float, drift: float, strength: float, seed: int) -> None:
    held = imprint(gel(strength, seed=100))
    assert share_left(untouched(), held, imprint(gel(0.0, light, drift, seed))) < LEFT_SHARE
    assert share_left(untouched(), held, imprint(gel(strength, light, drift, seed))) > LEFT_SHARE


def test_remaining_imprint_in_the_gel_is_not_a_contact() -> None:
    held = imprint(gel(1.0))
    assert share_left(untouched(), held, imprint(gel(0.3, seed=9))) == pytest.approx(0.3, abs=0.1)
