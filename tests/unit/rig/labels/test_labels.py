"""Masks as labels: outlines enclose the original mask, and the formats' own tools read the files."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.labels.label_files import outline_contact, write_coco, write_labelme
from rig.labels.polygons import mask_polygons, polygon_area, polygons_mask

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
SIZE = (240, 320)


def iou(one: Image, other: Image) -> float:
    return float(((one > 0) & (other > 0)).sum() / ((one > 0) | (other > 0)).sum())


@given(
    angle_deg=st.floats(-90.0, 90.0),
    half_axes=st.tuples(st.floats(10.0, 90.0), st.floats(10.0, 90.0)),
    center=st.tuples(st.floats(0.0, 240.0), st.floats(0.0, 320.0)),
)
def test_filled_outline_equals_its_mask(
    drawn_mask: Draw, angle_deg: float, half_axes: tuple[float, float], center: tuple[float, float]
) -> None:
    mask = drawn_mask(angle_deg, half_axes, center, SIZE)
    again = polygons_mask(mask_polygons(mask), SIZE)
    # the outline runs through the middle between two pixels, so it may differ by a few along it
    assert np.count_nonzero(mask != again) <= 8 + 0.02 * np.count_nonzero(mask)


def test_parts_become_outlines_and_holes_are_filled() -> None:
    mask = np.zeros((320, 240), np.uint8)
    mask[10:30, 20:60] = 255
    mask[15:20, 30:40] = 0
    mask[100:105, 200:240] = 255
    polygons = mask_polygons(mask)
    assert [polygon_area(p) for p in polygons] == pytest.approx([800.0, 200.0], abs=2.0)
    assert mask_polygons(np.zeros((8, 8), np.uint8)) == []


@pytest.mark.filterwarnings("ignore:__array__ implementation")  # pycocotools 2.0.11 with numpy 2
def test_coco_tools_read_the_file_and_fill_the_same_mask(drawn_mask: Draw, tmp_path: Path) -> None:
    pytest.importorskip("pycocotools")
    from pycocotools.coco import COCO

    far = drawn_mask(-50.0, (60.0, 20.0), (200.0, 300.0))
    masks = [drawn_mask(20.0), far, np.zeros((320, 240), np.uint8)]
    path = tmp_path / "coco.json"
    write_coco(path, [outline_contact(tmp_path / f"{i}.png", mask) for i, mask in enumerate(masks)], "test")
    coco = COCO(str(path))
    assert len(coco.getImgIds()) == 3
    assert [c["name"] for c in coco.loadCats(coco.getCatIds())] == ["contact"]
    for annotation in coco.loadAnns(coco.getAnnIds()):
        mask = masks[annotation["image_id"] - 1]
        assert iou(coco.annToMask(annotation), mask) > 0.98
        assert annotation["area"] == pytest.approx((mask > 0).sum(), rel=0.02)


def test_labelme_file_has_the_required_fields(drawn_mask: Draw, tmp_path: Path) -> None:
    write_labelme(tmp_path / "a.json", outline_contact(tmp_path / "a.png", drawn_mask(20.0)), "drawn")
    document = json.loads((tmp_path / "a.json").read_text())
    fields = {"version", "flags", "shapes", "imagePath", "imageData", "imageHeight", "imageWidth"}
    assert fields == set(document)
    (shape,) = document["shapes"]
    assert {"label", "points", "group_id", "shape_type", "flags", "description", "mask"} == set(shape)
    assert all(0 <= x <= 240 and 0 <= y <= 320 for x, y in shape["points"])
    assert document["imagePath"] == "a.png"
