"""Files are sorted by the numbers in their names."""

import random
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.formats import in_number_order
from drivers.video.files import image_files
from rig.calibrate.samples import picture_files
from rig.frames.masks import image_groups
from rig.frames.series import read_frames


@pytest.mark.parametrize(
    "names",
    [
        ["0.1337035.png", "0.867143.png", "1.2.png"],
        ["frame_9.5.png", "frame_10.25.png", "frame_10.3.png"],
        ["1763000000.9.png", "1763000000.95.png", "1763000001.0.png", "1763000001.05.png"],
        ["-0.5.png", "-0.25.png", "0.0.png", "5e-05.png", "0.0001.png"],
        ["t.0.15.png", "t.0.5.png"],
        ["1.8.png", "1.9.png", "1.10.png", "1.11.png", "2.1.png"],
        ["1.001.png", "1.002.png", "1.010.png", "2.000.png"],
        ["2.png", "10.png", "0100.png", "1000.png"],
        ["left2.png", "left10.png", "right1.png"],
        ["2026.11.9.png", "2026.11.26.png", "2026.12.1.png"],
        ["2026-11-26_17.56.09.5.png", "2026-11-26_17.56.10.1.png"],
        ["frame.0009.png", "frame.0010.png", "frame.10000.png"],
        ["1" + 40 * "0" + "1.png", "1" + 40 * "0" + "2.png"],
    ],
)
def test_numbers_in_names_are_compared_as_numbers(names: list[str]) -> None:
    for seed in range(5):
        mixed = [Path("x") / name for name in names]
        random.Random(seed).shuffle(mixed)
        assert [file.name for file in in_number_order(mixed)] == names


@pytest.mark.parametrize("writer", [str, "{:.4f}".format, "{:g}".format, "frame{:.6f}_left".format])
def test_names_that_are_times_are_sorted_by_time(writer) -> None:
    times = sorted(random.Random(1).uniform(0.0, 20.0) for _ in range(300))
    files = [Path(f"{writer(time)}.png") for time in times]
    assert in_number_order(reversed(files)) == sorted(files, key=files.index)


NUMBERED = ["9.png", "10.png", "100.png"], ["0.1337035.png", "0.867143.png", "1.25.png"]


@pytest.mark.parametrize("names", NUMBERED)
def test_every_list_of_images_is_in_order_of_numbers_without_hidden_files(
    tmp_path: Path, names: list[str]
) -> None:
    for shade, name in reversed(list(enumerate(names))):
        cv2.imwrite(str(tmp_path / name), np.full((40, 60, 3), 50 * shade, np.uint8))
        (tmp_path / f".{name}").write_bytes(b"metadata of another computer")
    (group,) = image_groups([tmp_path], f"first:{len(names) - 1}", compare=True)
    assert group.background is not None
    assert group.background.mean() == pytest.approx(25.0), "the mean of the first two by number"
    (bare,) = image_groups([tmp_path], None, compare=False)
    assert [file.name for file in bare.files] == names
    assert [file.name for file in picture_files(tmp_path)] == names
    assert [file.name for file in image_files(tmp_path)] == names
    assert [frame.name for frame in read_frames(tmp_path)] == names
