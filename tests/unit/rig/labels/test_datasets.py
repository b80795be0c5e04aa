"""Labelled images on disk in each layout, folds by object, and scores of masks."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from drivers.errors import InputError
from drivers.images import encode_png, read_image
from rig.labels.datasets import FOLDS, check_objects, find_fold, object_of, own_fold, read_dataset
from rig.labels.label_files import labelme_mask, read_label
from rig.labels.polygons import agreement, contact_label
from rig.sessions.codec import json_value
from rig.sessions.files import MANIFEST, REFERENCES, write_json
from rig.sessions.manifest import ReplayManifest, begin_manifest
from rig.training.examples import folder_examples

SHAPE = (60, 40)
SQUARE = [[10.0, 20.0], [30.0, 20.0], [30.0, 50.0], [10.0, 50.0]]


def write_image(path: Path, level: int = 90) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((*SHAPE, 3), level, np.uint8))
    return path


def write_label(path: Path, points: list[list[float]], kind: str = "polygon", image: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = {"label": "contact", "points": points, "shape_type": kind}
    document = {"shapes": [shape], "imagePath": image, "imageHeight": SHAPE[0], "imageWidth": SHAPE[1]}
    path.write_text(json.dumps(document))
    return path


def write_vistase(folder: Path, objects: tuple[str, ...]) -> None:
    """Each image is there twice, as the data set has it: as LabelMe and as VOC."""
    for name in objects:
        for number in range(3):
            voc = folder / name / "voc_format"
            write_image(voc / "JPEGImages" / f"{number}.jpg")
            (voc / "SegmentationClassPNG").mkdir(parents=True, exist_ok=True)
            mask = np.zeros((*SHAPE, 3), np.uint8)
            mask[20:50, 10:30] = (0, 0, 128)
            cv2.imwrite(str(voc / "SegmentationClassPNG" / f"{number}.png"), mask)
            write_image(folder / name / "image_label" / f"{number}.png")
            write_label(folder / name / "image_label" / f"{number}.json", SQUARE, image=f"{number}.png")


def test_the_papers_layout_is_read_once_with_its_object_ids(tmp_path: Path) -> None:
    write_vistase(tmp_path, ("01_mustard", "object_16", "spam"))
    files = read_dataset(tmp_path)
    assert [file.object_id for file in files] == ["1"] * 3 + ["16"] * 3 + ["7"] * 3
    for file in files:
        assert np.count_nonzero(file.label(SHAPE)) == 20 * 30
        assert not file.simulated
        assert file.background is None


def test_labelme_files_are_read_with_every_kind_of_shape(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    write_label(tmp_path / "a.json", [[10.0, 20.0], [30.0, 50.0]], "rectangle")
    write_image(tmp_path / "b.JPG")
    write_label(tmp_path / "b.json", [[20.0, 30.0], [20.0, 40.0]], "circle")
    write_image(tmp_path / "elsewhere" / "c.png")
    write_label(tmp_path / "c.json", SQUARE, image="elsewhere/c.png")
    (tmp_path / "notes.json").write_text("{}")
    areas = {f.image.name: np.count_nonzero(f.label(SHAPE)) for f in read_dataset(tmp_path)}
    assert areas["a.png"] == areas["c.png"] == 600
    assert abs(areas["b.JPG"] - np.pi * 100) < 8


def mask_shape(left: int, top: int, part: np.ndarray) -> dict[str, object]:
    """Return a shape as LabelMe writes it with "Create AI-Mask": a PNG of the part between two points."""
    points = [[left, top], [left + part.shape[1] - 1, top + part.shape[0] - 1]]
    png = base64.b64encode(encode_png(part)).decode()
    return {"label": "contact", "points": points, "shape_type": "mask", "mask": png}


def test_rectangle_of_four_points_and_mask_with_a_hole_are_read() -> None:
    size = {"imageHeight": SHAPE[0], "imageWidth": SHAPE[1]}
    turned = {"points": [[10.0, 5.0], [15.0, 10.0], [10.0, 15.0], [5.0, 10.0]], "shape_type": "rectangle"}
    diamond = np.count_nonzero(labelme_mask({"shapes": [turned], **size}, SHAPE, "a.json"))
    assert abs(diamond - 61) <= 8
    ring = np.ones((20, 10), np.uint8)
    ring[5:8, 4:6] = 0
    document = {"shapes": [mask_shape(7, 9, ring)], **size}
    mask = labelme_mask(document, SHAPE, "a.json")
    assert np.array_equal(mask[9:29, 7:17] > 0, ring > 0)
    assert np.count_nonzero(mask) == ring.sum()
    assert np.count_nonzero(labelme_mask(document, (2 * SHAPE[0], 2 * SHAPE[1]), "a.json")) == 4 * ring.sum()
    for wrong in (
        mask_shape(SHAPE[1] - 4, 0, ring),
        mask_shape(-1, 0, ring),
        {"shape_type": "mask", "mask": "x"},
    ):
        with pytest.raises(InputError, match="shape 1: its mask"):
            labelme_mask({"shapes": [wrong], **size}, SHAPE, "a.json")
    with pytest.raises(InputError, match="does not lie in its image"):
        labelme_mask({**document, "imageHeight": 1e8, "imageWidth": 1e8}, SHAPE, "a.json")


def test_a_label_drawn_on_another_size_is_scaled() -> None:
    document = {"shapes": [{"points": SQUARE}], "imageHeight": SHAPE[0], "imageWidth": SHAPE[1]}
    mask = labelme_mask(document, (2 * SHAPE[0], 2 * SHAPE[1]), "a.json")
    assert np.count_nonzero(mask) == 4 * 600


def test_misspelt_key_of_a_label_file_is_named_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{\n "shape": []\n}')
    with pytest.raises(
        InputError, match=r"a.json: .* no 'shapes' \(line 2, column 3 has 'shape'\): correct it"
    ):
        read_label(tmp_path / "a.json")


TINY = json.dumps({"shapes": [{"points": SQUARE}], "imageHeight": 1e-300, "imageWidth": 9})


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda d: (d / "a.json").write_text('{"shapes": ['), "complete JSON"),
        (lambda d: write_label(d / "a.json", SQUARE[:2]), "encloses nothing"),
        (lambda d: write_label(d / "a.json", [["x"]]), "points"),  # type: ignore[list-item]
        (lambda d: write_label(d / "a.json", [[0.0, 0.0], [float("nan"), 9.0]], "rectangle"), "NaN is not"),
        (lambda d: (d / "a.json").write_text('{"shapes": [], "imageHeight": "60"}'), "the size of its image"),
        (lambda d: write_label(d / "a.json", [[0.0, 0.0], [1e15, 9.0], [5.0, 9.0]]), "not in its image"),
        (lambda d: write_label(d / "a.json", [[0.0, 0.0], [1e15, 9.0]], "circle"), "not in its image"),
        (lambda d: write_label(d / "a.json", [[0.0, 0.0], [900.0, 9.0], [5.0, 9.0]]), "far outside"),
        (lambda d: (d / "a.json").write_text('{"shapes": [7]}'), "points cannot be read"),
        (
            lambda d: (d / "a.json").write_text('{"shapes": [\n {"point": []}]}'),
            r"a.json, shape 1: no 'points' \(line 2, column 4 has 'point'\)",
        ),
        (lambda d: (d / "a.json").write_text('{"shapes": [], "x": ' + "[" * 9000), "nested too deeply"),
        (lambda d: (d / "a.json").write_text(TINY), "far outside"),
        (lambda d: (d / "a.png").unlink(), "not beside it"),
    ],
)
def test_damaged_labels_are_named(damage, said: str, tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    write_label(tmp_path / "a.json", SQUARE, image="a.png")
    damage(tmp_path)
    with pytest.raises(InputError, match=said) as caught:
        [file.label(SHAPE) for file in read_dataset(tmp_path)]
    assert "a.json" in str(caught.value)


def test_a_folder_beside_a_session_is_not_inside_it(tmp_path: Path) -> None:
    (tmp_path / "run1").mkdir()
    manifest = ReplayManifest(**vars(begin_manifest("replay")), sessions=(), estimator=None, window=None)
    write_json(tmp_path / "run1" / MANIFEST, json_value(manifest))
    write_image(tmp_path / "run1_labels" / "a.png")
    write_label(tmp_path / "run1_labels" / "a.json", SQUARE, image="a.png")
    assert [file.image.name for file in read_dataset(tmp_path)] == ["a.png"]


def test_folder_without_labels_names_the_expected_files(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match=r"VISTASE|no such folder"):
            read_dataset(folder)


def test_folds_keep_test_objects_from_training() -> None:
    for fold in FOLDS.values():
        parts = (*fold.train, *fold.validation, *fold.test)
        assert sorted(parts, key=int) == [str(number) for number in range(1, 17)]
    assert find_fold("d_S3") is FOLDS["D_s3"]
    with pytest.raises(InputError, match="D_s1"):
        find_fold("D_s4")
    with pytest.raises(InputError, match="test"):
        check_objects(FOLDS["D_s3"], ["1", "4"], "data")


def test_one_own_object_is_trained_on_and_validated_by_a_folder_of_it(tmp_path: Path) -> None:
    for day in ("monday", "tuesday"):
        write_vistase(tmp_path / day, ("my_box",))
        write_image(tmp_path / day / "my_box" / REFERENCES / "empty.png")
    fold = own_fold(["tuesday"], [])
    assert fold.test == ("tuesday",)
    examples = folder_examples(tmp_path, (20, 30), named=fold.validation)
    check_objects(fold, examples.objects, "data")
    assert examples.objects == ("my_box",) * 3 + ("tuesday",) * 3
    with pytest.raises(InputError, match=r"no object to train with .* found my_box"):
        check_objects(own_fold(["my_box"], []), ["my_box"], "data")
    with pytest.raises(InputError, match=r"no object to validate with .* found my_box.*--validate FOLDER"):
        check_objects(own_fold(["sunday"], []), ["my_box"], "data")


def test_an_objects_id_is_read_from_its_folder() -> None:
    expected = {"07_spam": "7", "object12": "12", "spam": "7", "my thing": "my thing"}
    assert {name: object_of(Path(name)) for name in expected} == expected


def test_a_label_encloses_rings_and_close_parts_and_leaves_far_ones_apart() -> None:
    touching = np.zeros((320, 240), np.uint8)
    cv2.circle(touching, (70, 80), 40, 255, 3)
    cv2.ellipse(touching, (180, 260), (30, 12), 30, 0, 360, 255, -1)
    label = contact_label(touching)
    assert label[80, 70] == 255
    assert cv2.connectedComponents(label)[0] == 3
    assert not contact_label(np.zeros_like(touching)).any()


def test_scores_of_empty_masks() -> None:
    nothing, all_ = np.zeros((4, 4), np.uint8), np.full((4, 4), 255, np.uint8)
    assert agreement(None, nothing).dice == agreement(nothing, nothing).iou == 1.0
    assert agreement(None, all_).dice == 0.0
    with pytest.raises(InputError, match="one size"):
        agreement(all_, np.zeros((5, 4), np.uint8))


def labelled(folder: Path, size: tuple[int, int], orientation: int = 1) -> Path:
    """Write two images with an EXIF orientation, and labels of a size: a LabelMe file and a mask."""
    facts = Image.Exif()
    facts[0x0112] = orientation
    for image in (folder / "a.jpg", folder / "voc_format" / "JPEGImages" / "b.jpg"):
        image.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (80, 60), "grey").save(image, exif=facts)
    document = {"shapes": [{"points": [[10, 10], [30, 10], [30, 40]]}], "imagePath": "a.jpg"}
    document |= {"imageWidth": size[0], "imageHeight": size[1]}
    (folder / "a.json").write_text(json.dumps(document))
    masks = folder / "voc_format" / "SegmentationClassPNG"
    masks.mkdir()
    Image.new("L", size, 255).save(masks / "b.png")
    return folder


@pytest.mark.parametrize(
    ("size", "orientation", "said"),
    [
        ((60, 80), 1, "is 60 x 80 px, its image 80 x 60 px, upright: it is turned by 90 degrees"),
        ((80, 60), 6, "is 80 x 60 px, its image 60 x 80 px, upright: it is turned by 90 degrees"),
        ((80, 60), 8, "turned by 90 degrees"),
        ((80, 80), 1, "of another picture"),
        ((80, 64), 1, "of another picture"),
    ],
)
def test_label_that_had_to_be_stretched_is_refused(
    tmp_path: Path, size: tuple[int, int], orientation: int, said: str
) -> None:
    files = read_dataset(labelled(tmp_path, size, orientation))
    assert len(files) == 2
    for file in files:
        shape = read_image(file.image).shape[:2]
        with pytest.raises(InputError, match=rf"(a\.json|b\.png): .*{said}"):
            file.label(shape)


@pytest.mark.parametrize(
    ("size", "orientation"), [((80, 60), 1), ((80, 60), 3), ((60, 80), 6), ((40, 30), 1), ((27, 20), 1)]
)
def test_label_of_the_same_aspect_is_read(tmp_path: Path, size: tuple[int, int], orientation: int) -> None:
    for file in read_dataset(labelled(tmp_path, size, orientation)):
        shape = read_image(file.image).shape[:2]
        assert file.label(shape).shape == shape
