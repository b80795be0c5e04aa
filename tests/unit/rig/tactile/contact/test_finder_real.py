"""The classical contact mask on real DIGIT frames, against human labels."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.tactile.contact.background import auto_background
from rig.tactile.contact.finder import ContactFinder

Image = NDArray[np.uint8]


def read(path: Path, flag: int = cv2.IMREAD_COLOR_RGB) -> Image:
    image = cv2.imread(str(path), flag)
    assert image is not None
    return np.asarray(image, np.uint8)


def dice(mask: Image | None, truth: NDArray[np.bool_]) -> float:
    if mask is None:
        return 0.0
    return 2 * np.count_nonzero((mask > 0) & truth) / (np.count_nonzero(mask) + np.count_nonzero(truth))


@pytest.fixture(scope="module")
def panels(real_data: Path) -> list[tuple[Image, NDArray[np.bool_]]]:
    folder = real_data / "aurova_figures" / "panels"
    return [
        (read(folder / f"{n}_raw.png"), read(folder / f"{n}_label.png", cv2.IMREAD_GRAYSCALE) > 127)
        for n in range(1, 10)
    ]


def test_masks_agree_with_the_labels(panels: list[tuple[Image, NDArray[np.bool_]]]) -> None:
    background = auto_background([image for image, _ in panels])
    scores = [dice(ContactFinder(background).find(image).mask, label) for image, label in panels]
    assert np.mean(scores) > 0.88
    assert min(scores) > 0.7


def test_masks_agree_where_the_frame_had_no_part_in_its_background(
    panels: list[tuple[Image, NDArray[np.bool_]]],
) -> None:
    images = [image for image, _ in panels]
    scores = [
        dice(ContactFinder(auto_background(images[:i] + images[i + 1 :])).find(image).mask, label)
        for i, (image, label) in enumerate(panels)
    ]
    assert np.mean(scores) > 0.87


def test_a_real_frame_without_contact_shows_none(real_data: Path) -> None:
    bare = read(real_data / "digit_backgrounds" / "tacto_bg_digit_240_320.jpg")
    finder = ContactFinder(bare)
    rng = np.random.default_rng(0)
    for light in (1.0, 0.8, 1.15):
        frame = np.clip(bare * light + rng.normal(0, 1.5, bare.shape), 0, 255).astype(np.uint8)
        assert finder.find(frame).mask is None
