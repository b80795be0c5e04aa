"""Dots printed on a gel are recognised, are not a contact, and do not disturb the angle."""

from collections import Counter
from collections.abc import Callable
from itertools import islice, product
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.formats import read_csv_rows
from drivers.images import read_image
from rig.frames.series import read_frames
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.dots import is_dotted, without_dots
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State
from rig.tactile.slip.estimator import SlipEstimator

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
STEP_NS = 16_666_667


def grid(spacing_px: float = 32.0, shift_px: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    """Places of a regular print on a frame of 240 x 320."""
    x, y = np.meshgrid(np.arange(16.0, 240.0, spacing_px), np.arange(16.0, 320.0, spacing_px))
    return np.stack([x, y], axis=-1).reshape(-1, 2) + shift_px


def pushed(places: NDArray[np.float64], by_px: float) -> NDArray[np.float64]:
    """Those near the middle pushed to the right, as a contact leaves them that has gone."""
    near = np.exp(-((places - (120.0, 160.0)) ** 2).sum(axis=1) / (2 * 40.0**2))
    return places + np.outer(near, (by_px, 0.0))


def printed(image: Image, places: NDArray[np.float64], radius_px: float = 6.0) -> Image:
    """A frame with soft dark dots, as ink on a gel."""
    ink = np.zeros(image.shape[:2], np.float32)
    for x, y in places:
        centre = (round(16 * float(x)), round(16 * float(y)))
        cv2.circle(ink, centre, round(16 * radius_px), 1.0, -1, cv2.LINE_AA, 4)
    ink = cv2.GaussianBlur(ink, (0, 0), 0.8)[..., None]
    return np.rint(image * (1.0 - 0.85 * ink)).astype(np.uint8)


def states(frames: list[Image], background: Image, name: str = "slip") -> list[State]:
    estimator = choose_estimator(name).make(background)
    return [estimator.update(frame, i * STEP_NS).state for i, frame in enumerate(frames)]


def test_gel_with_printed_dots_is_recognised(blank: Image) -> None:
    for radius_px, spacing_px in product((4.5, 6.0, 9.0), (28.0, 44.0)):
        assert is_dotted(printed(blank, grid(spacing_px), radius_px)), (radius_px, spacing_px)


def test_filling_dots_restores_the_gel(blank: Image) -> None:
    gap = without_dots(printed(blank, grid())).astype(int) - blank
    assert np.abs(gap).max() <= 6
    assert np.abs(gap).mean() < 0.5


@pytest.mark.parametrize("name", ["slip", "ellipse", "ecc"])
def test_moved_dots_are_not_a_contact(blank: Image, name: str) -> None:
    background = printed(blank, grid())
    moved = [printed(blank, pushed(grid(), 0.5 * i)) for i in range(12)]
    assert set(states(moved, background, name)) == {State.NO_CONTACT}
    as_if_plain = SlipEstimator(background)
    seen = [as_if_plain.update(frame, i * STEP_NS).state for i, frame in enumerate(moved)]
    assert State.TRACKING in seen, "without filling them they would be"


@pytest.mark.heavy
def test_angle_is_measured_between_the_dots(blank: Image, press: Draw) -> None:
    background = printed(blank, grid())
    estimator = choose_estimator("slip").make(background)
    for i in range(30):
        turn = max(0.0, 1.0 * (i - 12))
        # The print follows the gel, which gives way less than the object turns.
        frame = printed(press(15 + turn, (85, 25), seed=i), grid(shift_px=(0.05 * i, 0.0)))
        sample = estimator.update(frame, i * STEP_NS)
        assert sample.state is not State.NO_CONTACT
        assert "dots" in sample.stage_s
        if i == 12:
            zero = sample.angle_deg
        last = sample.angle_deg
    assert last - zero == pytest.approx(17.0, abs=1.0)


def test_source_of_the_angles_is_named(blank: Image) -> None:
    dotted = printed(blank, grid())
    assert choose_estimator("slip").sees(dotted) == "what lies between the printed dots"
    assert choose_estimator("kolamuri").sees(dotted) == "the printed dots"
    assert choose_estimator("slip").sees(blank) == choose_estimator("pca-published").sees(dotted)


def test_real_gels_with_and_without_dots_are_distinguished(real_data: Path) -> None:
    folder = real_data
    plain = [
        folder / "digit_backgrounds" / "tacto_bg_digit_240_320.jpg",
        folder / "aurova_figures" / "digit_raw.png",
    ]
    plain += sorted((folder / "gelsight_ball").glob("*_1*.png"))
    plain += sorted((folder / "aurova_figures" / "panels").glob("*_raw.png"))
    assert len(plain) > 20
    assert not any(is_dotted(read_image(path)) for path in plain)
    for clip in sorted((folder / "marker_slip_clips").glob("*.avi")):
        capture = cv2.VideoCapture(str(clip))
        frames = [capture.read()[1] for _ in range(12)]
        capture.release()
        assert is_dotted(np.ascontiguousarray(frames[-1][..., ::-1])), clip.name


SPANS = Path(__file__).resolve().parents[4] / "data" / "marker_slip_contacts.csv"


@pytest.mark.heavy
def test_printed_dots_are_not_reported_as_contact(real_data: Path) -> None:
    folder = real_data / "marker_slip_clips"
    rows = [row for _, row in read_csv_rows(SPANS, ("clip", "first", "last", "contact", "background"))]
    frames: Counter[str] = Counter()
    reported: Counter[str] = Counter()
    for clip in dict.fromkeys(row["clip"] for row in rows):
        spans = [row for row in rows if row["clip"] == clip]
        first, last = int(spans[0]["background_first"]), int(spans[0]["background_last"])
        background = read_frames(folder / spans[0]["background"]).images()
        estimator = choose_estimator("slip").make(mean_background(list(islice(background, first, last + 1))))
        in_contact = [
            estimator.update(frame.image, frame.time.time_ns).state is not State.NO_CONTACT
            for frame in read_frames(folder / clip)
            if frame.image is not None
        ]
        for span in spans:
            answers = in_contact[int(span["first"]) : int(span["last"]) + 1]
            frames[span["contact"]] += len(answers)
            reported[span["contact"]] += sum(answers)
    assert frames == {"no": 2690, "yes": 354}
    assert reported["no"] <= 0.05 * frames["no"]
    assert reported["yes"] >= 0.95 * frames["yes"]
