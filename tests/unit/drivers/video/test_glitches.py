"""Detection of damaged images: on simulated units, on real frames, and on undamaged images of other kinds."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import DeviceError
from drivers.images import encode_jpeg
from drivers.video.digit import MAX_SHIFTED, GlitchCheck, is_green
from drivers.video.stream import decode
from fakes.gel.sensor import GelSensor

SHIFTS = (3, 5, 12, 37, 160, 317)


@cache
def unit(seed: int, frame: int = 0) -> np.ndarray:
    """A read-only frame of another sensor unit."""
    return GelSensor(seed).render(None, 0.0, np.random.default_rng(frame))


def judged(*images: np.ndarray) -> list[str | None]:
    check = GlitchCheck()
    return [check.flaw(image) for image in images]


@pytest.mark.parametrize("seed", range(6))
def test_shift_is_detected_on_every_unit_at_every_size(seed: int) -> None:
    for shift in SHIFTS:
        assert judged(unit(seed, 1), np.roll(unit(seed, 2), shift, axis=0)) == [None, "shifted"]


def test_noise_light_and_contact_are_not_reported_as_glitches(press) -> None:
    images = [press(None, seed=1), press(20.0, seed=2), press(80.0, center=(60, 250), seed=3)]
    images += [press(None, light=(0.5, 0.5, 0.5), seed=4), np.zeros_like(images[0])]
    assert judged(*images) == [None] * len(images)


def test_flat_and_drawn_pictures_are_not_reported_as_glitches() -> None:
    square = np.zeros((320, 240, 3), np.uint8)
    square[40:120, 50:150] = 255
    flat = [np.full((320, 240, 3), grey, np.uint8) for grey in (0, 90, 255)]
    assert judged(*flat, square, np.roll(square, 60, axis=0), square[::-1]) == [None] * 6


def test_empty_or_partly_empty_buffer_is_green_also_after_jpeg() -> None:
    image = unit(2).copy()
    assert not is_green(image)
    image[:, 200:] = (0, 135, 0)  # lines that never came: columns of the upright image
    assert is_green(image)
    assert is_green(decode(encode_jpeg(image)))
    assert is_green(np.full((320, 240, 3), (0, 135, 0), np.uint8))


def test_permanently_shifted_stream_must_be_reopened() -> None:
    check = GlitchCheck()
    check.flaw(unit(1, 1))
    for _ in range(MAX_SHIFTED - 1):
        assert check.flaw(np.roll(unit(1, 2), 40, axis=0)) == "shifted"
    with pytest.raises(DeviceError, match="shifted"):
        check.flaw(np.roll(unit(1, 2), 40, axis=0))
    check.note_reopening()
    assert check.flaw(np.roll(unit(1, 3), 40, axis=0)) == "shifted"
    assert check.flaw(unit(1, 3)) is None


def test_real_frames_pass_and_shifted_ones_are_detected(real_data: Path) -> None:
    files = [real_data / "aurova_figures" / "digit_raw.png", *(real_data / "digit_backgrounds").glob("*.jpg")]
    files += sorted((real_data / "aurova_figures" / "panels").glob("*_raw.png"))
    assert len(files) > 9
    images = [cv2.resize(decode(file.read_bytes()), (240, 320)) for file in files]
    noise = np.random.default_rng(0).normal(0.0, 1.5, images[0].shape)
    for one in images:
        assert [judged(one, other) for other in images] == [[None, None]] * len(images)
        for shift in SHIFTS:
            seen = np.clip(np.roll(one, shift, axis=0) + noise, 0, 255).astype(np.uint8)
            assert judged(one, seen) == [None, "shifted"], shift
