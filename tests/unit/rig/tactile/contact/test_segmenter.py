"""The contact mask of a network: accuracy, flagged frames, and invalid network files."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.images import read_image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import draw_variation
from fakes.objects.catalogue import load_catalogue
from fakes.objects.surfaces import build_surface, depth_for_force
from rig.benchmark.segmentation import PANELS, read_panels
from rig.frames.masks import SegmentChoice, make_segmenter, shipped_cards
from rig.labels.polygons import agreement, contact_label
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.model_files import MODELS
from rig.tactile.contact.network import SHIPPED, load_network
from rig.tactile.contact.segmenter import FrameState, Segmenter, moved_outline
from rig.training.examples import Examples
from support.onnx_bytes import INT64, field, identity_model, model, node

Image = NDArray[np.uint8]


@pytest.fixture(scope="module")
def pressed() -> tuple[Image, Image, Image]:
    """Background, frame and label of a mug's handle on a unit unlike those of the bench."""
    rng = np.random.default_rng(4)
    unit = GelSensor(991, variation=draw_variation(np.random.default_rng(8)))
    surface = build_surface(load_catalogue()["2"].sites[2], 1, 5)
    imprint = Imprint(surface, 25.0, (0.5, -0.8), depth_for_force(surface, 0.9))
    return unit.render(None, 0.0, rng), unit.render(imprint, 3.0, rng), contact_label(unit.touching(imprint))


@pytest.mark.parametrize("model", [*SHIPPED, "classical"])
def test_contact_on_an_unseen_unit_is_found(model: str, pressed: tuple[Image, Image, Image]) -> None:
    background, frame, label = pressed
    contact = make_segmenter(SegmentChoice(model), background).segment(frame)
    assert contact.state is FrameState.CONTACT
    contact = contact.contact
    assert agreement(contact.mask, label).dice > 0.93
    assert contact.mask is not None
    assert contact.area_px == np.count_nonzero(contact.mask)
    assert contact.contour.shape[1:] == (1, 2)
    assert contact.contour.dtype == np.float32


@pytest.mark.parametrize("model", ["ours", "classical"])
def test_unusable_frames_have_no_mask_and_a_reason(model: str, pressed: tuple[Image, Image, Image]) -> None:
    background = pressed[0]
    segmenter = make_segmenter(SegmentChoice(model), background)
    for image, state in (
        (background, FrameState.NO_CONTACT),
        (np.zeros_like(background), FrameState.BLACK),
        (np.full_like(background, 255), FrameState.SATURATED),
    ):
        found = segmenter.segment(image)
        assert found.state is state
        assert found.contact.mask is None


def test_margin_moves_the_outline_by_a_fraction_of_the_width(drawn_mask) -> None:
    mask = drawn_mask(20.0)
    wider, narrower = moved_outline(mask, 0.02), moved_outline(mask, -0.02)
    assert np.all(narrower <= mask)
    assert np.all(mask <= wider)
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
    expected = np.count_nonzero(cv2.dilate(mask, ball))
    assert abs(np.count_nonzero(wider) - expected) < 0.03 * expected
    np.testing.assert_array_equal(moved_outline(mask, 0.0), mask)
    with pytest.raises(InputError, match="margin"):
        Segmenter(load_network("pspnet"), margin=0.5)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((320, 240), np.uint8), "shape"),
        (np.zeros((320, 240, 3), np.float32), "float32"),
        (np.zeros((160, 120, 3), np.uint8), "one size"),
        (np.zeros((1640, 10, 3), np.uint8), "no side may be 40 times the other"),
        (None, "uint8"),
    ],
)
def test_images_of_another_type_or_size_are_refused(
    image: object, said: str, pressed: tuple[Image, Image, Image]
) -> None:
    with pytest.raises(InputError, match=said):
        Segmenter(load_network("ours"), pressed[0]).find(image)  # type: ignore[arg-type]


def test_network_with_background_input_requires_a_background() -> None:
    with pytest.raises(InputError, match="--background"):
        Segmenter(load_network("ours"))


def test_invalid_network_file_is_rejected_with_its_path(tmp_path: Path) -> None:
    cut = tmp_path / "cut.onnx"
    cut.write_bytes((MODELS / "ours.onnx").read_bytes()[:5000])
    empty = tmp_path / "empty.onnx"
    empty.touch()
    for path, said in ((tmp_path / "none.onnx", "network not found"), (cut, "ONNX"), (empty, "ONNX")):
        with pytest.raises(InputError, match=said) as caught:
            load_network(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("shape", [(1, 3, 32, 32), (1, 1, 32, 32), (3, 32, 32)])
def test_network_of_another_shape_is_rejected(shape: tuple[int, ...], tmp_path: Path) -> None:
    (tmp_path / "other.onnx").write_bytes(identity_model(shape))
    with pytest.raises(InputError, match="maps"):
        load_network(tmp_path / "other.onnx")


def test_cards_match_the_shipped_files() -> None:
    cards = shipped_cards()
    assert [card["name"] for card in cards] == list(SHIPPED)
    for card in cards:
        assert card["simulated"]
        assert not set(card["fold"]["test"]) & set(card["fold"]["train"])
        assert card["shipped"]["holds"]
        assert card["shipped"]["bytes"] < 5e6


def test_failing_network_is_named(tmp_path: Path) -> None:
    """Gather takes a channel that is not there: nothing shows before it runs."""
    path, axis = tmp_path / "gather.onnx", field(1, "axis") + field(3, 1) + field(20, 2)
    place = field(1, 1) + field(2, INT64) + field(7, bytes([99])) + field(8, "i")
    path.write_bytes(model([node("Gather", ["x", "i"], ["y"], axis)], [place]))
    network = load_network(path)
    with pytest.raises(InputError, match=r"gather\.onnx: fails when it is run \(.+\): export it again"):
        network.logits(np.zeros((3, 32, 32), np.float32))


@pytest.fixture(scope="module")
def panels(real_data: Path) -> Examples:
    if not (real_data / PANELS).is_dir():
        pytest.skip(f"no real frames in {real_data}")
    return read_panels(real_data / PANELS)


def dice(panels: Examples, margin: float = 0.0, alone: bool = False) -> list[float]:
    segmenter = Segmenter(load_network("ours"), panels.backgrounds[0], margin, alone)
    pairs = zip(panels.frames, panels.labels, strict=True)
    return [agreement(segmenter.find(frame).mask, label).dice for frame, label in pairs]


def test_masks_agree_with_the_labels(panels: Examples) -> None:
    scores = sorted(dice(panels))
    assert np.mean(scores) >= 0.93
    # an edge in a dark corner is the hardest of the nine; of the others none is missed by much
    assert scores[0] > 0.8
    assert scores[1] > 0.9
    alone = sorted(dice(panels, alone=True))
    assert alone[0] < 0.7, "the network alone misses half of that edge"
    assert alone[1:] == pytest.approx(scores[1:], abs=0.01)


@pytest.mark.heavy
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


def test_outline_without_margin_fits_manual_labels_best(panels: Examples) -> None:
    at_zero = np.mean(dice(panels))
    assert at_zero > np.mean(dice(panels, -0.03))
    assert at_zero > np.mean(dice(panels, 0.03))
