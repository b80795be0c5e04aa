"""Files of pictures: in the forms of other programs, in the order of their names, several in one file."""

import random
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image as Pillow

from drivers.errors import InputError
from drivers.formats import in_number_order, picture_count, picture_flaw, unpacking
from drivers.images import image_flaw, load_image, read_image
from drivers.video.files import PLAYED_SUFFIXES, image_files
from rig.calibrate.samples import picture_files
from rig.frames.masks import image_groups
from rig.frames.series import read_frames

HEIGHT, WIDTH = 48, 64
RAMP = np.stack(
    [np.tile(np.linspace(20, 230, WIDTH), (HEIGHT, 1)), np.full((HEIGHT, WIDTH), 90.0),
     np.tile(np.linspace(200, 40, HEIGHT)[:, None], (1, WIDTH))], axis=2,
).astype(np.uint8)  # fmt: skip
PICTURE = Pillow.fromarray(RAMP)
GREY = np.repeat(np.asarray(PICTURE.convert("L"))[..., None], 3, axis=2)
LIGHT = np.asarray(PICTURE.convert("L"))


def exif(path: Path) -> None:
    """Store the picture lying on its side, with the EXIF header of its orientation."""
    facts = Pillow.Exif()
    facts[0x0112] = 6
    PICTURE.transpose(Pillow.Transpose.ROTATE_90).save(path, quality=100, subsampling=0, exif=facts)


FORMS: dict[str, tuple[Callable[[Path], object], np.ndarray, float]] = {
    "palette.png": (lambda p: PICTURE.quantize(256).save(p), RAMP, 24),
    "alpha.png": (lambda p: PICTURE.convert("RGBA").save(p), RAMP, 0),
    "grey.png": (lambda p: PICTURE.convert("L").save(p), GREY, 0),
    "grey_alpha.png": (lambda p: PICTURE.convert("LA").save(p), GREY, 0),
    "sixteen_bit.png": (lambda p: cv2.imwrite(str(p), RAMP[..., ::-1].astype(np.uint16) * 257), RAMP, 1),
    "cmyk.jpg": (lambda p: PICTURE.convert("CMYK").save(p, quality=100), RAMP, 12),
    "exif.jpg": (exif, RAMP, 8),
    "progressive.jpg": (lambda p: PICTURE.save(p, quality=100, subsampling=0, progressive=True), RAMP, 8),
    "subsampled.jpg": (lambda p: PICTURE.save(p, quality=95), RAMP, 12),
    "grey.jpg": (lambda p: PICTURE.convert("L").save(p, quality=100), GREY, 4),
    "palette.bmp": (lambda p: PICTURE.quantize(256).save(p), RAMP, 24),
    "lossless.webp": (lambda p: PICTURE.save(p, lossless=True), RAMP, 0),
    "planar.tif": (
        lambda p: tifffile.imwrite(p, RAMP.transpose(2, 0, 1), planarconfig="separate", photometric="rgb"),
        RAMP, 0,
    ),
    "lzw.tif": (lambda p: PICTURE.save(p, compression="tiff_lzw"), RAMP, 0),
    "big_endian.tif": (lambda p: tifffile.imwrite(p, RAMP, byteorder=">", photometric="rgb"), RAMP, 0),
    "deflate.tif": (lambda p: PICTURE.save(p, compression="tiff_adobe_deflate"), RAMP, 0),
    "big.tif": (lambda p: tifffile.imwrite(p, RAMP, bigtiff=True, photometric="rgb"), RAMP, 0),
    "big_big_endian.tif": (
        lambda p: tifffile.imwrite(p, RAMP, bigtiff=True, byteorder=">", photometric="rgb"), RAMP, 0,
    ),
    "float32.tif": (lambda p: tifffile.imwrite(p, np.float32(RAMP / 255.0), photometric="rgb"), RAMP, 0),
    "float64.tif": (lambda p: tifffile.imwrite(p, RAMP / 255.0, photometric="rgb", byteorder=">"), RAMP, 0),
    "float_to_255.tif": (lambda p: tifffile.imwrite(p, np.float32(RAMP), photometric="rgb"), RAMP, 0),
    "float_big.tif": (
        lambda p: tifffile.imwrite(p, np.float32(RAMP / 255.0), photometric="rgb", bigtiff=True), RAMP, 0,
    ),
    "float_planes.tif": (
        lambda p: tifffile.imwrite(
            p, np.float32(RAMP.transpose(2, 0, 1) / 255.0), planarconfig="separate", photometric="rgb"
        ),
        RAMP, 0,
    ),
    "float_grey.tif": (lambda p: tifffile.imwrite(p, np.float32(GREY[..., 0] / 255.0)), GREY, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_picture_is_the_same_in_every_form(tmp_path: Path, name: str) -> None:
    write, wanted, tolerance = FORMS[name]
    write(tmp_path / name)
    found = read_image(tmp_path / name)
    assert found.shape == wanted.shape
    assert np.abs(found.astype(int) - wanted).max() <= tolerance


@pytest.mark.parametrize("value", [np.nan, -0.1, 256.0])
def test_floats_outside_the_ranges_of_pictures_are_refused_by_name(tmp_path: Path, value: float) -> None:
    values = np.full((40, 50, 3), 0.5, np.float32)
    values[3, 4] = value
    tifffile.imwrite(tmp_path / "x.tif", values, photometric="rgb")
    with pytest.raises(InputError, match=r"x\.tif: has floating-point values that are not all from 0 to 1"):
        read_image(tmp_path / "x.tif")


def test_big_tiff_of_several_pages_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", np.stack([RAMP, RAMP]), bigtiff=True, photometric="rgb")
    with pytest.raises(InputError, match="holds 2 images"):
        read_image(tmp_path / "x.tif")


def stack(path: Path, count: int) -> Path:
    pages = [np.full((HEIGHT, WIDTH, 3), 20 * i, np.uint8) for i in range(count)]
    if path.name.startswith("tifffile"):
        with tifffile.TiffWriter(path) as writer:
            for page in pages:
                writer.write(page, photometric="rgb")
    elif path.name.startswith("imagej"):
        tifffile.imwrite(path, np.stack(pages)[..., 0], imagej=True)
    elif path.name.startswith("opencv"):
        assert cv2.imwritemulti(str(path), pages)
    else:
        first, *more = map(Pillow.fromarray, pages)
        first.save(path, save_all=True, append_images=more)
    return path


STACKED = ("tifffile.tif", "imagej.tiff", "opencv.tif", "pillow.tif", "animated.webp", "animated.png")


@pytest.mark.parametrize("name", STACKED)
def test_file_of_several_pictures_is_refused_everywhere(tmp_path: Path, name: str) -> None:
    (tmp_path / "frames").mkdir()
    path = stack(tmp_path / "frames" / name, 3)
    assert picture_count(path.read_bytes()) == 3
    for what in (path, path.parent):
        with pytest.raises(InputError, match="holds 3 images, but only one would be read"):
            read_frames(what)
    with pytest.raises(InputError, match="holds 3 images"):
        read_image(path)
    assert load_image(path) is None
    assert stack(tmp_path / name, 1).exists()
    assert image_flaw(tmp_path / name) is None


@pytest.mark.parametrize(
    ("kind", "renamed"),
    [("animated.png", "5.png"), ("animated.webp", "5.png"), ("tifffile.tif", "5.jpg"),
     ("pillow.tif", "5.bmp"), ("opencv.tif", "5.tif")],
)  # fmt: skip
def test_animation_among_single_images_is_refused_by_name_whatever_its_suffix(
    tmp_path: Path, kind: str, renamed: str
) -> None:
    for number in range(5):
        cv2.imwrite(str(tmp_path / f"{number}.png"), RAMP)
    stack(tmp_path / kind, 2).rename(tmp_path / renamed)
    for read in (read_frames, lambda folder: image_groups([folder], None, compare=False)):
        with pytest.raises(InputError, match=rf"{renamed}: holds 2 images"):
            read(tmp_path)
    if renamed.endswith(PLAYED_SUFFIXES):
        with pytest.raises(InputError, match=rf"{renamed}: holds 2 images"):
            image_files(tmp_path)


def test_preview_is_no_second_picture_and_a_damaged_list_of_pages_an_error(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "x.tif") as writer:
        writer.write(RAMP, photometric="rgb")
        writer.write(np.ascontiguousarray(RAMP[::4, ::4]), photometric="rgb", subfiletype=1)
    assert np.array_equal(read_image(tmp_path / "x.tif"), RAMP)
    data = bytearray(stack(tmp_path / "pillow.tif", 3).read_bytes())
    first = int.from_bytes(data[4:8], "little")
    entries = int.from_bytes(data[first : first + 2], "little")
    place = first + 2 + 12 * entries
    data[place : place + 4] = data[4:8]  # the first page again
    assert "holds more than 1 images" in str(picture_flaw(bytes(data)))


@pytest.mark.heavy
def test_deep_samples_and_large_tiles_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tifffile.imwrite(tmp_path / "x.tif", np.zeros((400, 400, 4)), photometric="rgb", compression="zlib")
    cv2.imwrite(str(tmp_path / "x.png"), np.zeros((400, 400, 4), np.uint16))
    assert image_flaw(tmp_path / "x.png") is None
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 1_000_000)
    for name in ("x.tif", "x.png"):
        assert "become" in str(image_flaw(tmp_path / name)), name
    tile = np.zeros((16, 16), np.uint8)
    tifffile.imwrite(tmp_path / "tile.tif", tile, tile=(16384, 16384), compression="zlib")
    assert str(image_flaw(tmp_path / "tile.tif")).startswith("is 16384 x 16384 px")


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
        ["a_1.005.png", "a_1.0500.png", "a_1.1.png", "a_1.250.png", "a_2.0.png"],
        ["1.08.png", "1.09.png", "1.10.png", "1.100.png"],
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
