"""Backgrounds that do not belong to the frames are named and give no angle; right ones are not named."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rig
from drivers.clock import NS_PER_S, SystemClock
from drivers.images import read_image
from drivers.types import Frame, Image
from rig.frames.estimates import CHECKED_FRAMES
from rig.frames.series import evenly_spread
from rig.live.desk_sensor import DeskSensor
from rig.tactile.contact import misfit as misfits
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.background_check import BackgroundCheck
from rig.tactile.contact.untouched import Comparison
from rig.tactile.estimators import choose_estimator
from support.desk_frames import desk_frames

STEP_NS = NS_PER_S // 10
SHIFTS = [(10, 0), (0, -10), (-12, 9), (0, 16), (0, 20)]


def shifted(image: Image, x: float, y: float) -> Image:
    size = (image.shape[1], image.shape[0])
    way = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    return np.asarray(cv2.warpAffine(image, way, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def dead(image: Image, rows: slice = slice(0), columns: slice = slice(0)) -> Image:
    copy = image.copy()
    copy[rows] = 0
    copy[:, columns] = 40
    return copy


def compressed(image: Image, quality: int) -> Image:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def misfit(background: Image, frames: Iterable[Image]) -> str:
    check = BackgroundCheck(background)
    for place, image in evenly_spread(enumerate(frames), CHECKED_FRAMES):
        check.check(image, place * STEP_NS)
    return check.misfit


@pytest.fixture(scope="module")
def desk() -> list[Frame]:
    """Frames of a simulated press, 30 per second: 1 s without contact, then a touch and a turn."""
    return list(desk_frames(8.0))


def background_of(desk: Sequence[Frame]) -> Image:
    return mean_background([frame.image for frame in desk[:15]])


@pytest.mark.heavy
def test_right_background_fits(desk: list[Frame]) -> None:
    assert misfit(background_of(desk), [frame.image for frame in desk[::3]]) == ""


@pytest.mark.parametrize("light", [0.5, 0.75, 1.3])
def test_other_brightness_is_no_misfit(desk: list[Frame], light: float) -> None:
    frames = [np.clip(frame.image * light, 0, 255).astype(np.uint8) for frame in desk[::3]]
    assert misfit(background_of(desk), frames) == ""


@pytest.mark.parametrize("way", SHIFTS)
def test_shifted_background_is_named_with_its_shift(desk: list[Frame], way: tuple[int, int]) -> None:
    text = misfit(shifted(background_of(desk), *way), [frame.image for frame in desk[::3]])
    assert text.startswith("the frames do not fit the background: shifted by about ")
    assert float(text.split()[-2]) == pytest.approx(np.hypot(*way), rel=0.45)


@pytest.mark.parametrize("name", misfits.TURNS)
def test_turned_or_mirrored_background_is_named(desk: list[Frame], name: str) -> None:
    wrong = np.asarray(cv2.flip(background_of(desk), misfits.TURNS[name]), np.uint8)
    text = misfit(wrong, [frame.image for frame in desk[::6]])
    assert text == f"the frames do not fit the background: it is {name}"


@pytest.mark.parametrize("way", [(8, 0), (-8, 0)])
def test_shift_along_which_the_gel_hardly_changes_is_named(desk: list[Frame], way: tuple[int, int]) -> None:
    """The light of this gel changes downwards: the size of the shift is less certain."""
    assert "shifted by about" in misfit(shifted(background_of(desk), *way), [f.image for f in desk[::3]])


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("rows", "columns", "name"),
    [
        (slice(304, 320), slice(0), "dead rows (16)"),
        (slice(0), slice(100, 103), "dead columns (3)"),
        (slice(7, 8), slice(0), "dead rows (1)"),
    ],
)
def test_dead_lines_are_named(desk: list[Frame], rows: slice, columns: slice, name: str) -> None:
    frames = [dead(frame.image, rows, columns) for frame in desk]
    assert misfit(background_of(desk), frames) == f"the frames do not fit the background: {name}"
    assert misfit(mean_background(frames[:15]), frames) == "", "the background has them too"


@pytest.mark.filterwarnings("error")
def test_frame_of_the_size_of_a_block_has_no_blocks() -> None:
    small = np.random.default_rng(0).integers(0, 255, (8, 40, 3), np.uint8)
    assert misfit(small, [small] * 5) == ""


def test_black_frame_with_the_width_of_blocks_is_not_compression(desk: list[Frame]) -> None:
    frames = [np.zeros_like(frame.image) for frame in desk[::6]]
    for frame, framed in zip(desk[::6], frames, strict=True):
        framed[16:-16, 24:-24] = frame.image[16:-16, 24:-24]
    assert misfit(frames[0], frames) == ""


@pytest.mark.heavy
@pytest.mark.parametrize(("quality", "named"), [(30, True), (70, False)])
def test_strong_compression_is_named_with_its_own_remedy(
    desk: list[Frame], quality: int, named: bool
) -> None:
    background, noise = background_of(desk), np.random.default_rng(1)
    check = BackgroundCheck(background)
    for frame in desk[::3]:
        grain = cv2.GaussianBlur(noise.normal(0.0, 12.0, frame.image.shape), (0, 0), 1.0)
        image = np.clip(np.rint(frame.image + grain), 0, 255).astype(np.uint8)
        check.check(compressed(image, quality), frame.time_ns)
    doubt = check.doubt_with("take another background")
    expected = "blocks of 8 pixels hide the contact: store or send them with JPEG quality 80 or more"
    assert doubt.endswith(expected) if named else doubt == ""


@pytest.mark.heavy
def test_recorded_frames_with_a_shifted_background_have_no_angle(desk: list[Frame]) -> None:
    frames, times_s = [frame.image for frame in desk], [frame.time_ns / NS_PER_S for frame in desk]
    with pytest.warns(UserWarning, match="do not fit the background: shifted by about"):
        found = rig.estimate(frames, shifted(background_of(desk), 10, 0), times_s=times_s)
    assert np.isnan(found.angle_deg).all()
    assert not {"tracking", "rekeyed"} & set(found.states)


@pytest.mark.heavy
def test_streamed_frames_with_dead_rows_have_no_angle(desk: list[Frame]) -> None:
    stream = rig.estimator(background=background_of(desk))
    with pytest.warns(UserWarning, match="dead rows") as warned:
        found = [stream.update(dead(f.image, slice(304, 320)), f.time_ns / NS_PER_S) for f in desk]
    assert len(warned) == 1
    assert all(sample.angle_deg is None and sample.state != "tracking" for sample in found[30:])


@pytest.mark.parametrize(("rate_hz", "frames"), [(60.0, 30), (30.0, 20), (10.0, 10), (1.0, 10)])
def test_shift_is_found_within_half_a_second_or_a_few_frames(
    desk: list[Frame], rate_hz: float, frames: int
) -> None:
    check = BackgroundCheck(shifted(background_of(desk), 0, -10))
    for place in range(frames):
        check.add(desk[-1 - place % 30].image, round(place * NS_PER_S / rate_hz))
    assert "shifted by about" in check.misfit


def test_frames_that_fit_are_compared_seldom_and_in_small_steps(
    desk: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    check, steps = BackgroundCheck(background_of(desk)), list[str]()
    for owner, name in (
        (Comparison, "region"), (misfits, "_blocks"), (misfits, "_smaller"), (misfits, "_valley"),
    ):  # fmt: skip
        inner = getattr(owner, name)

        def noted(*of: Any, name: str = name, inner: Any = inner) -> Any:
            steps.append(name)
            return inner(*of)

        monkeypatch.setattr(owner, name, noted)
    found = list[str]()
    for place in range(600):
        steps.clear()
        check.add(desk[-1 - place % 30].image, round(place * NS_PER_S / 60.0))
        assert len(set(steps)) <= 1, "no frame waits for two steps"
        found += set(steps)
    assert found == ["region", "_blocks", "_smaller", "_valley"] * 5, "at 0, 0.5, 1.5, 3.5 and 7.5 s"


@pytest.mark.heavy
def test_live_view_with_a_shifted_background_has_a_doubt_and_no_angle(desk: list[Frame]) -> None:
    sensor = DeskSensor("D", choose_estimator("slip"), 1, shifted(background_of(desk), -12, 9), None)
    shown = [sensor.take(frame, SystemClock()).values() for frame in desk]
    assert "do not fit the background: shifted by about" in str(shown[-1]["doubt"])
    assert shown[-1]["angle_deg"] is None
    assert shown[-1]["state"] == "lost"


def real_clips_of(folder: Path) -> list[tuple[Image, list[Image]]]:
    found = []
    for background in sorted(folder.glob("*/background.png")):
        files = sorted((background.parent / "frames").iterdir())
        chosen = np.unique(np.linspace(0, len(files) - 1, 24).astype(int))
        found.append((read_image(background), [read_image(files[i]) for i in chosen]))
    return found


def test_backgrounds_of_real_clips_fit_and_shifted_ones_do_not(real_clips: Path) -> None:
    clips = real_clips_of(real_clips)
    assert [misfit(*clip) for clip in clips] == [""] * len(clips)
    named = [misfit(shifted(background, 8, -6), frames) for background, frames in clips]
    assert all("shifted by about" in text for text in named)
    assert not any(misfit(shifted(background, 1, 0), frames) for background, frames in clips)
    found = [misfit(shifted(background, 0, 2), frames) for background, frames in clips]
    assert sum("shifted by about 2 px" in text for text in found) >= 0.8 * len(clips)
    strong = [misfit(background, [compressed(frame, 30) for frame in frames]) for background, frames in clips]
    assert all("blocks of 8 pixels" in text for text in strong)


def test_backgrounds_of_real_turns_fit_and_turned_ones_do_not() -> None:
    folder = Path(os.environ.get("RIG_REAL_TURNS", ""))
    if not (folder / "pk_133601").is_dir():
        pytest.skip("RIG_REAL_TURNS does not name the folder that real_turns/make.py makes")
    clips = real_clips_of(folder)
    assert not any(misfit(*clip) for clip in clips)
    for name, code in misfits.TURNS.items():
        found = [misfit(np.asarray(cv2.flip(image, code), np.uint8), frames) for image, frames in clips]
        assert sum(name in text for text in found) >= len(clips) - 1, "one gel is nearly symmetric"
