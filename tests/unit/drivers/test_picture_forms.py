"""One picture in the forms in which other programs store it; files with several pictures are refused."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image as Pillow

from drivers.errors import InputError
from drivers.formats import picture_count, picture_flaw, unpacking
from drivers.images import image_flaw, load_image, read_image
from drivers.video.files import PLAYED_SUFFIXES, image_files
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
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_picture_is_the_same_in_every_form(tmp_path: Path, name: str) -> None:
    write, wanted, tolerance = FORMS[name]
    write(tmp_path / name)
    found = read_image(tmp_path / name)
    assert found.shape == wanted.shape
    assert np.abs(found.astype(int) - wanted).max() <= tolerance


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


def test_one_stack_among_single_images_is_refused_by_name(tmp_path: Path) -> None:
    for i in range(5):
        stack(tmp_path / f"pillow_{i}.tif", 2 if i == 3 else 1)
    with pytest.raises(InputError, match=r"pillow_3\.tif: holds 2 images"):
        read_frames(tmp_path)


@pytest.mark.parametrize(
    ("kind", "renamed"),
    [
        ("animated.png", "5.png"),
        ("animated.webp", "5.png"),
        ("tifffile.tif", "5.jpg"),
        ("pillow.tif", "5.bmp"),
    ],
)
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


def test_preview_in_a_file_is_no_second_picture(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "x.tif") as writer:
        writer.write(RAMP, photometric="rgb")
        writer.write(np.ascontiguousarray(RAMP[::4, ::4]), photometric="rgb", subfiletype=1)
    assert np.array_equal(read_image(tmp_path / "x.tif"), RAMP)


def test_damaged_list_of_pages_is_an_error(tmp_path: Path) -> None:
    data = bytearray(stack(tmp_path / "pillow.tif", 3).read_bytes())
    first = int.from_bytes(data[4:8], "little")
    entries = int.from_bytes(data[first : first + 2], "little")
    place = first + 2 + 12 * entries
    data[place : place + 4] = data[4:8]  # the first page again
    assert "holds more than 1 images" in str(picture_flaw(bytes(data)))


def test_deep_samples_and_large_tiles_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tifffile.imwrite(tmp_path / "x.tif", np.zeros((400, 400, 4)), photometric="rgb", compression="zlib")
    cv2.imwrite(str(tmp_path / "x.png"), np.zeros((400, 400, 4), np.uint16))
    assert image_flaw(tmp_path / "x.png") is None
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 1_000_000)
    for name in ("x.tif", "x.png"):
        assert "become" in str(image_flaw(tmp_path / name)), name
    tifffile.imwrite(
        tmp_path / "tile.tif", np.zeros((16, 16), np.uint8), tile=(16384, 16384), compression="zlib"
    )
    assert str(image_flaw(tmp_path / "tile.tif")).startswith("is 16384 x 16384 px")
