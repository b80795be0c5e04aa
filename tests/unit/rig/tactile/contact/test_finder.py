"""The classical contact mask on drawn and real frames, and the rule for touch."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.images import read_image
from rig.tactile.contact.background import auto_background
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.contact.gate import TouchDebounce

Image = NDArray[np.uint8]
Draw = Callable[..., Image]


def dice(mask: Image | None, truth: Image) -> float:
    if mask is None:
        return 0.0
    return 2 * np.count_nonzero(mask & truth) / (np.count_nonzero(mask) + np.count_nonzero(truth))


def is_sound(contact: Contact, image: Image) -> bool:
    """Check that mask, area and contour agree, or that all show no contact."""
    if contact.mask is None:
        return contact.area_px == 0 and len(contact.contour) == 0
    inside = contact.mask.shape == image.shape[:2] and set(np.unique(contact.mask)) <= {0, 255}
    return inside and contact.area_px == np.count_nonzero(contact.mask) > 0


@pytest.mark.parametrize("angle_deg", [0, 35, 90, -60])
def test_the_mask_covers_the_contact(press: Draw, blank: Image, drawn_mask: Draw, angle_deg: float) -> None:
    contact = ContactFinder(blank).find(press(angle_deg))
    assert dice(contact.mask, drawn_mask(angle_deg)) > 0.85


@pytest.mark.parametrize("noise", [0.0, 1.5, 4.0, 12.0])
def test_noise_gives_no_contact(press: Draw, blank: Image, noise: float) -> None:
    finder = ContactFinder(blank)
    found = [finder.find(press(None, noise=noise, seed=seed)) for seed in range(10)]
    assert all(contact.mask is None for contact in found)


@pytest.mark.parametrize("light", [(0.75, 0.75, 0.75), (1.15, 1.0, 0.9), (0.6, 0.8, 1.1)])
def test_drifting_light_does_not_change_the_detection(
    press: Draw, blank: Image, drawn_mask: Draw, light: tuple[float, float, float]
) -> None:
    finder = ContactFinder(blank)
    assert finder.find(press(None, light=light)).mask is None
    assert dice(finder.find(press(30, light=light)).mask, drawn_mask(30)) > 0.85


def test_speck_below_a_hundredth_of_the_frame_is_no_contact(press: Draw, blank: Image) -> None:
    finder = ContactFinder(blank)
    assert finder.find(press(20, (8.0, 5.0), strength=2.0)).mask is None
    assert finder.find(press(20, (20.0, 12.0), strength=2.0)).mask is not None


@pytest.mark.heavy
def test_contact_detection_has_hysteresis(press: Draw, blank: Image) -> None:
    strengths = np.arange(0.02, 0.6, 0.01)
    frames = [press(0, strength=strength) for strength in strengths]
    fresh = [ContactFinder(blank).find(frame).mask is not None for frame in frames]
    finder = ContactFinder(blank)
    fading = [finder.find(frame).mask is not None for frame in reversed(frames)]
    assert fresh == sorted(fresh)
    assert fading == sorted(fading, reverse=True)
    assert 0 < sum(fresh) < sum(fading) < len(frames)


def test_the_contour_runs_along_the_mask(press: Draw, blank: Image) -> None:
    contact = ContactFinder(blank).find(press(-20))
    assert contact.contour.dtype == np.float32
    assert contact.contour.shape[1:] == (1, 2)
    # The polygon through the middles of its outermost pixels lacks half a pixel all around.
    rim_px = cv2.arcLength(contact.contour, True)
    assert cv2.contourArea(contact.contour) == pytest.approx(contact.area_px - rim_px / 2, rel=0.02)
    gaps = np.linalg.norm(np.diff(contact.contour[:, 0], axis=0), axis=1)
    assert gaps.max() < 1.5


CONTENT = st.one_of(
    hnp.arrays(np.uint8, (24, 18, 3)),
    st.integers(0, 255).map(lambda grey: np.full((24, 18, 3), grey, np.uint8)),
    st.integers(0, 24 * 18 * 3 - 1).map(
        lambda i: np.eye(1, 24 * 18 * 3, i, dtype=np.uint8).reshape(24, 18, 3)
    ),
    st.integers(0, 2**32 - 1).map(
        lambda seed: np.random.default_rng(seed).choice([0, 255], (24, 18, 3)).astype(np.uint8)
    ),
)


@given(background=CONTENT, frames=st.lists(CONTENT, min_size=1, max_size=3))
def test_any_image_gives_a_valid_result(background: Image, frames: list[Image]) -> None:
    finder = ContactFinder(background)
    assert all(is_sound(finder.find(frame), frame) for frame in frames)


@pytest.mark.parametrize("tightness", [0.0, -1.0, float("nan"), 11.0])
def test_invalid_tightness_is_an_input_error(blank: Image, tightness: float) -> None:
    with pytest.raises(InputError, match="tightness"):
        ContactFinder(blank, tightness)


@pytest.fixture(scope="module")
def panels(real_data: Path) -> list[tuple[Image, Image]]:
    """Real frames, and their contacts as people drew them."""
    folder = real_data / "aurova_figures" / "panels"
    return [
        (
            read_image(folder / f"{n}_raw.png"),
            255 * np.uint8(read_image(folder / f"{n}_label.png")[..., 0] > 127),
        )
        for n in range(1, 10)
    ]


def test_masks_of_real_frames_agree_with_the_labels(panels: list[tuple[Image, Image]]) -> None:
    background = auto_background([image for image, _ in panels])
    scores = [dice(ContactFinder(background).find(image).mask, label) for image, label in panels]
    assert np.mean(scores) > 0.88
    assert min(scores) > 0.7


@pytest.mark.heavy
def test_masks_agree_with_a_background_from_other_frames(panels: list[tuple[Image, Image]]) -> None:
    images = [image for image, _ in panels]
    scores = [
        dice(ContactFinder(auto_background(images[:i] + images[i + 1 :])).find(image).mask, label)
        for i, (image, label) in enumerate(panels)
    ]
    assert np.mean(scores) > 0.87


def test_real_frame_without_contact_has_no_mask(real_data: Path) -> None:
    bare = read_image(real_data / "digit_backgrounds" / "tacto_bg_digit_240_320.jpg")
    finder = ContactFinder(bare)
    rng = np.random.default_rng(0)
    for light in (1.0, 0.8, 1.15):
        frame = np.clip(bare * light + rng.normal(0, 1.5, bare.shape), 0, 255).astype(np.uint8)
        assert finder.find(frame).mask is None


def test_touch_needs_three_frames_without_a_gap() -> None:
    touch = TouchDebounce()
    seen = []
    for contact in (True, False, True, True, True, False):
        touch.update(contact)
        seen.append(touch.sure)
    assert seen == [False, False, False, True, True, False]
