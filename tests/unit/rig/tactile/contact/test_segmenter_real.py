"""The shipped network on nine real frames of one sensor, against human labels; and on another make's."""

from pathlib import Path

import numpy as np
import pytest

from drivers.images import read_image
from rig.benchmark.segmentation.panels import Panels, panels_picture, read_panels
from rig.labels.scores import agreement
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.network import load_network
from rig.tactile.contact.segmenter import Segmenter, moved_outline


@pytest.fixture(scope="module")
def panels(real_data: Path) -> Panels:
    panels = read_panels(real_data)
    if panels is None:
        pytest.skip(f"no real frames in {real_data}")
    return panels


def dice(panels: Panels, margin: float = 0.0) -> list[float]:
    segmenter = Segmenter(load_network("ours"), panels.background, margin)
    pairs = zip(panels.frames, panels.labels, strict=True)
    return [agreement(segmenter.find(frame).mask, label).dice for frame, label in pairs]


def test_masks_agree_with_the_labels(panels: Panels) -> None:
    scores = sorted(dice(panels))
    assert np.mean(scores) >= 0.93
    # an edge in a dark corner is the hardest of the nine; of the others none is missed by much
    assert scores[0] > 0.8
    assert scores[1] > 0.9


def test_contacts_on_a_sensor_of_another_make_are_found(real_data: Path) -> None:
    folder = real_data / "gelsight_ball"
    if not folder.is_dir():
        pytest.skip(f"no real balls in {real_data}")
    background = read_image(folder / "background.png")
    segmenter, classical = Segmenter(load_network("ours"), background), ContactFinder(background)
    dice = []
    for path in sorted(folder.glob("*mm_*.png")):
        found, seen = segmenter.find(read_image(path)), classical.find(read_image(path))
        assert found.mask is not None, f"{path.name}: a ball is pressed into the gel here"
        dice.append(agreement(found.mask, seen.mask).dice)
    assert len(dice) == 67
    assert np.mean(dice) > 0.8


def test_the_label_is_neither_looser_nor_tighter_than_a_persons(panels: Panels) -> None:
    at_zero = np.mean(dice(panels))
    assert at_zero > np.mean(dice(panels, -0.03))
    assert at_zero > np.mean(dice(panels, 0.03))


def test_the_picture_shows_every_frame_of_every_method(panels: Panels) -> None:
    masks = {"label": panels.labels, "wider": [moved_outline(label, 0.02) for label in panels.labels]}
    picture = panels_picture(panels, masks)
    height, width = panels.frames[0].shape[:2]
    assert picture.shape == (2 * (2 * height + 26), 9 * 2 * width, 3)
