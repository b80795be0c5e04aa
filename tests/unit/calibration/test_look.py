"""The look of a unit and the noise of its camera: fitted, checked on presses left out, stored, drawn."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.gel.look import load_look, visibility
from calibration.gel.look_fit import LookFit, Pressed, ball_dent, fit_look, jpeg_quality
from calibration.gel.noise import measure_noise
from drivers.errors import CalibrationError
from drivers.types import Image
from fakes.gel.sensor import GelSensor
from rig.calibrate.press_folder import read_circled
from rig.tactile.contact.relative import RelativeDifference
from rig.tactile.slip import gradient
from rig.tactile.slip.estimator import SlipEstimator
from support.simulated_gel import MM_PER_PX, SimulatedGel, draw_press

GEL = SimulatedGel(seed=3)


@cache
def background() -> Image:
    return np.rint(GEL.reference).astype(np.uint8)


def _pressed(count: int) -> list[Pressed]:
    presses = GEL.presses(count)
    return [Pressed(p.name, p.image, (*p.centre_px, p.contact_px), p.radius_mm) for p in presses]


@pytest.fixture(scope="module")
def fit() -> LookFit:
    return fit_look(_pressed(12), background(), MM_PER_PX)


@pytest.mark.heavy
def test_held_out_presses_are_rendered_from_their_circles(fit: LookFit) -> None:
    assert len(fit.held_out) == 12
    assert fit.error_share < 0.6
    assert all(press.rms_grey < press.change_grey for press in fit.held_out)


@pytest.mark.heavy
def test_look_is_read_back_unchanged_or_refused(
    fit: LookFit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tactile-D1.npz"
    path.write_bytes(replace(fit.look, about={"serial": "D1"}).pack())
    again = load_look(path)
    dent = np.zeros((160, 120), np.float32)
    dent[40:80, 30:60] = 0.3
    assert again.about == {"serial": "D1"}
    assert np.allclose(again.change(dent), fit.look.change(dent), atol=0.1)
    assert np.abs(again.background - fit.look.background).max() < 0.2
    monkeypatch.setattr("calibration.gel.look.SCHEMA", 1)
    with pytest.raises(CalibrationError, match=r"format 2, this version reads 1.*make it again"):
        load_look(path)
    with pytest.raises(
        CalibrationError, match=r"for images of \(240, 320\) px.*calibrate the sensor at this"
    ):
        SlipEstimator(np.full((240, 320, 3), 90, np.uint8), look=fit.look)


@pytest.mark.heavy
def test_simulated_gel_takes_background_and_noise_of_its_look(fit: LookFit) -> None:
    unit, rng = GelSensor(5, look=fit.look), np.random.default_rng(0)
    still = np.mean([unit.render(None, 0.0, rng) for _ in range(12)], axis=0)
    assert np.abs(still - fit.look.background).mean() < 2.0
    assert unit.mm_per_px == fit.look.mm_per_px


@pytest.mark.heavy
def test_varied_look_depends_on_its_seed_only(fit: LookFit) -> None:
    press = fit.presses[0]
    own, one, same, other = (
        draw_press(look, 1, press.circle, press.radius_mm).change
        for look in (fit.look, fit.look.varied(1), fit.look.varied(1), fit.look.varied(2))
    )
    assert np.array_equal(one, same)
    assert np.abs(one - own).max() > 5.0
    assert np.abs(one - other).max() > 5.0


@pytest.mark.heavy
def test_visibility_falls_where_two_colours_oppose_each_other(fit: LookFit) -> None:
    median, worst, _ = visibility(fit.look)
    assert 0.0 < worst < median
    only_red = replace(fit.look, weights=fit.look.weights * (1.0, 1e-3, 1e-3))
    assert visibility(only_red)[0] < 0.1 * median


def test_too_few_presses_are_refused() -> None:
    with pytest.raises(CalibrationError, match="3 usable pictures, 8 are needed"):
        fit_look(_pressed(3), background(), MM_PER_PX)


def test_damaged_look_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "look.npz"
    with pytest.raises(CalibrationError, match="no such look"):
        load_look(path)
    for content in (b"", b"PK\x03\x04damaged", b"x" * 500):
        path.write_bytes(content)
        with pytest.raises(CalibrationError, match=r"look\.npz: is not a gel's look"):
            load_look(path)


@pytest.mark.heavy
def test_noise_is_measured_in_untouched_frames_if_there_are_enough() -> None:
    rng = np.random.default_rng(8)
    noisy = [
        np.clip(np.rint(GEL.reference + rng.normal(0.0, 6.0, GEL.reference.shape)), 0, 255) for _ in range(9)
    ]
    untouched = [frame.astype(np.uint8) for frame in noisy]
    fitted = fit_look(_pressed(8), background(), MM_PER_PX, untouched)
    assert fitted.look.noise.sigma_grey == pytest.approx([6.0, 6.0, 6.0], rel=0.15)


def test_jpeg_quality_is_found_if_a_picture_was_compressed() -> None:
    _, data = cv2.imencode(".jpg", background()[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, 75))
    assert jpeg_quality(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB)) == pytest.approx(75, abs=1)
    assert jpeg_quality(GEL.frame(np.random.default_rng(0))) is None


def test_real_presses_left_out_keep_less_than_half_of_their_colour_error() -> None:
    folder = Path(os.environ.get("RIG_DIGIT_BALLS", ""))
    if not (folder / "circles.csv").is_file():
        pytest.skip("RIG_DIGIT_BALLS does not name the folder that digit_balls/rebuild.py makes")
    background, circled = read_circled(folder)
    presses = [Pressed(str(i), image, circle, 4.4) for i, (image, circle) in enumerate(circled)]
    assert fit_look(presses, background, (0.05353, 0.05353)).error_share < 0.5


def _unexplained(fit: LookFit, corrections: int, monkeypatch: pytest.MonkeyPatch) -> float:
    """Share of the slopes of a rendered dent that the calibrated look does not give back, after a gain."""
    monkeypatch.setattr(gradient, "CORRECTIONS", corrections)
    look, size = fit.look, (60, 80)
    dent = ball_dent((120.0, 160.0, 60.0), 15.0, look.shape, look.mm_per_px)
    background = np.rint(look.background).astype(np.uint8)
    change = cv2.resize(look.change(dent.astype(np.float32)), look.shape[::-1])
    frame = np.clip(background + change, 0, 255).astype(np.uint8)
    light = RelativeDifference(background, size)
    depth = cv2.resize(dent, size, interpolation=cv2.INTER_AREA)
    mask = (depth > 0.05).astype(np.uint8)
    slopes = gradient.CalibratedSlopes(look, background, size).of(light.of(light.reduce(frame)), mask)
    true = np.dstack(np.gradient(depth, *(4.0 * mm for mm in look.mm_per_px))[::-1])
    inside = mask > 0
    found, known = slopes[inside][:, :2].ravel(), true[inside].ravel()
    return float(1.0 - (found @ known) ** 2 / ((found @ found) * (known @ known)))


@pytest.mark.heavy
def test_corrections_recover_the_slopes_of_a_rendered_dent(
    fit: LookFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    linear, corrected = (_unexplained(fit, count, monkeypatch) for count in (0, 3))
    assert corrected < 0.02
    assert corrected < 0.5 * linear


SHAPE = (160, 120)
PAIR_SIGMA = 2.0


def _frames_with_shared_colour(count: int) -> list[NDArray[np.floating]]:
    """Brightness noise of each pixel, and red noise that two rows share, as of cameras with 4:2:0 colour."""
    rng, frames = np.random.default_rng(3), []
    for _ in range(count):
        frame = np.repeat(rng.normal(0.0, 1.0, (*SHAPE, 1)), 3, axis=2)
        frame[..., 0] += np.repeat(rng.normal(0.0, PAIR_SIGMA, (SHAPE[0] // 2, SHAPE[1])), 2, axis=0)
        frames.append(np.rint(frame))
    return frames


def test_drawn_noise_has_the_colours_and_the_row_pairs_of_the_frames() -> None:
    frames = _frames_with_shared_colour(6)
    noise = measure_noise(frames, [np.ones(SHAPE, bool)] * 6)
    drawn = noise.draw(SHAPE, 4, np.random.default_rng(0))
    assert drawn.std((0, 1, 2)) == pytest.approx(noise.sigma_grey, rel=0.03)
    assert noise.sigma_grey == pytest.approx([5.0**0.5, 1.0, 1.0], rel=0.03)
    red = drawn[..., 0] - drawn[..., 1]
    within_pairs, across_pairs = (np.abs(np.diff(red, axis=1))[:, start::2].mean() for start in (0, 1))
    assert within_pairs < 0.3 * across_pairs


def test_contacts_are_left_out_of_the_noise() -> None:
    frames, free = _frames_with_shared_colour(4), np.ones(SHAPE, bool)
    free[40:90, 30:80] = False
    without = measure_noise(frames, [free] * 4).sigma_grey
    for frame in frames:
        frame[40:90, 30:80] += 60.0
    assert measure_noise(frames, [free] * 4).sigma_grey == pytest.approx(without)


def test_scaled_noise_has_the_scaled_standard_deviation() -> None:
    noise = measure_noise(_frames_with_shared_colour(2), [np.ones(SHAPE, bool)] * 2)
    assert noise.scaled(0.5).sigma_grey == pytest.approx(0.5 * noise.sigma_grey)
