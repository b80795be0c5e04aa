"""The gel: reference and drift, scale, detection of balls, and the map from colour to slope."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.gel.balls import BallFit, Press, ball_radius_mm, calibrate_gel, find_press, fit_scale
from calibration.gel.gradient_map import GradientMap, fit_gradient_map
from calibration.gel.reference import assess_reference, drift_since, make_reference
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from drivers.formats import read_csv_rows
from drivers.images import read_image
from support.simulated_gel import MM_PER_PX, MadePress, SimulatedGel

GEL = SimulatedGel(seed=3)


@pytest.fixture(scope="module")
def fitted() -> BallFit:
    presses = [_found(p) for p in GEL.presses(16)]
    return calibrate_gel(presses, MM_PER_PX, folds=4)


def _found(made: MadePress) -> Press:
    press = find_press(made.image, GEL.reference, made.name, made.radius_mm)
    assert isinstance(press, Press), press
    return press


@pytest.mark.heavy
def test_held_out_balls_are_reconstructed_at_their_radius(fitted) -> None:
    assert set(fitted.radius_error()) == {3.0, 5.0}
    # the simulated colours saturate with the slope, which the map follows in part only
    assert all(abs(error) < 0.12 for error in fitted.radius_error().values()), fitted.radius_error()
    assert fitted.null_rms < 0.03
    for made in GEL.presses(3, seed=9):
        found = ball_radius_mm(_found(made), fitted.map, MM_PER_PX)
        assert found == pytest.approx(made.radius_mm, rel=0.2)


@pytest.mark.heavy
def test_slopes_point_away_from_the_middle_of_a_dent(fitted) -> None:
    made = GEL.presses(1, seed=2)[0]
    press = _found(made)
    x, y = (round(v) for v in made.centre_px)
    right, left = np.array([[x + 12.0, y]]), np.array([[x - 12.0, y]])
    slope = [fitted.map.slopes(press.change[[y], [round(p[0, 0])]], p)[0, 0] for p in (right, left)]
    assert slope[0] < 0.0 < slope[1]


def test_map_is_exact_if_colour_is_linear_in_slope() -> None:
    rng = np.random.default_rng(0)
    normals = rng.uniform(-0.4, 0.4, (4000, 2))
    places = rng.uniform(0, 1, (4000, 2)) * (320, 240)
    change = normals @ rng.normal(0, 1, (2, 3))
    made: GradientMap = fit_gradient_map(change, places, normals, (240, 320))
    assert np.sqrt(((made.normals(change, places) - normals) ** 2).mean()) < 5e-3
    with pytest.raises(CalibrationError, match="too few"):
        fit_gradient_map(change[:50], places[:50], normals[:50], (240, 320))
    with pytest.raises(CalibrationError, match="not finite"):
        fit_gradient_map(change * np.nan, places, normals, (240, 320))


@pytest.mark.heavy
def test_ball_of_impossible_radius_is_rejected() -> None:
    made = GEL.presses(8, seed=4)
    presses = [_found(p) for p in made]
    radii = (0.5, float("nan"), float("inf"), 1e308, -1.0, 0.0, 60.0)
    wrong = [replace(presses[0], radius_mm=radius_mm) for radius_mm in radii]
    rejected = calibrate_gel([*wrong, *presses], MM_PER_PX).rejected
    assert len(rejected) == len(radii)
    assert "wider than a ball" in rejected[0].reason
    assert all("fit a gel" in each.reason for each in rejected[1:])


def hot_pixel(frame: np.ndarray) -> np.ndarray:
    frame[100, 100] = 255
    return frame


def lined(frame: np.ndarray) -> np.ndarray:
    frame[20:300, 118:124] = np.minimum(frame[20:300, 118:124].astype(int) + 80, 255)
    return frame


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda frame: frame, "no contact"),
        (hot_pixel, "no contact"),
        (lined, "not round"),
        (lambda frame: np.minimum(frame.astype(int) + 60, 255).astype(np.uint8), "not round"),
        (lambda frame: np.full_like(frame, 90), "alike"),
        (lambda frame: frame[:100], "differ in size"),
        (lambda frame: frame[..., 0], "RGB is needed"),
        (lambda frame: frame.astype(np.float32), "RGB is needed"),
    ],
    ids=["no contact", "hot pixel", "line", "brighter", "constant", "other size", "grey", "float"],
)
def test_picture_without_a_round_press_is_refused(change: Callable[[Any], Any], reason: str) -> None:
    try:
        said = str(find_press(change(GEL.frame(np.random.default_rng(1))), GEL.reference, "press", 4.0))
    except CalibrationError as error:
        said = str(error)
    assert reason in said


def test_three_presses_are_too_few_for_a_colour_map() -> None:
    with pytest.raises(CalibrationError, match="8 are the least"):
        calibrate_gel([_found(made) for made in GEL.presses(3)], MM_PER_PX)


def _still(gain: tuple[float, ...] = (1.0, 1.0, 1.0), count: int = 10, press: bool = False) -> list:
    rng = np.random.default_rng(0)
    frames = [GEL.presses(1)[0].image if press else GEL.frame(rng) for _ in range(count)]
    return [np.clip(f * np.asarray(gain), 0, 255).astype(np.uint8) for f in frames]


def test_a_reference_is_judged_against_the_earlier_one() -> None:
    earlier = make_reference(_still()).image
    same = make_reference(_still())
    assert assess_reference(same, drift_since(same, earlier)).verdict is Verdict.GOOD
    assert "would not be detected" in assess_reference(same).doubts[0]
    with pytest.raises(CalibrationError, match="is not the earlier"):
        drift_since(same, earlier[:100])


@pytest.mark.heavy
def test_unusable_references_are_refused_with_the_reason() -> None:
    other = SimulatedGel(seed=8)
    for frames, reason in (
        ([], "at least 5 are needed"),
        (_still((0.0, 0.0, 0.0)), "alike"),
        (_still((0.03, 0.03, 0.03)), "dark"),
        ([*_still(), np.zeros((9, 9, 3), np.uint8)], "differ"),
        (_still((0.05, 1.0, 1.0)), "LED went out"),
        (_still((0.8, 0.8, 0.8)), "light changed"),
        (_still((6.0, 6.0, 6.0)), "saturated"),
        (_still(press=True), "changed shape"),
        ([other.frame(np.random.default_rng(i)) for i in range(10)], "changed shape"),
        ([*_still(count=6), *_still(count=6, press=True)], "changed while"),
    ):
        try:
            reference = make_reference(frames)
            said = str(assess_reference(reference, drift_since(reference, GEL.reference)))
        except CalibrationError as error:
            said = str(error)
        assert reason in said


def test_scales_along_x_and_y_are_distinguished() -> None:
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-4, 4, 3), np.linspace(-5, 5, 3))
    moves = np.column_stack([x.ravel(), y.ravel()])
    centres = moves / (0.058, 0.063) + (120, 160) + rng.normal(0, 0.4, moves.shape)
    scale = fit_scale(moves, centres)
    assert scale.mm_per_px == pytest.approx([0.058, 0.063], rel=0.02)
    assert (np.abs(scale.mm_per_px - [0.058, 0.063]) < 4 * scale.sigma).all()
    for wrong in ((moves[:3], centres[:3]), (moves * (1, 0), centres)):
        with pytest.raises(CalibrationError, match="span both axes"):
            fit_scale(*wrong)


@pytest.mark.heavy
def test_held_out_real_gelsight_balls_are_reconstructed_within_five_percent(real_data: Path) -> None:
    folder = real_data / "gelsight_ball"
    reference = read_image(folder / "background.png").astype(np.float32)
    presses = []
    for _, row in read_csv_rows(folder / "catalog.csv", ("image", "diameter(mm)")):
        radius_mm = float(row["diameter(mm)"]) / 2.0
        found = find_press(read_image(folder / row["image"]), reference, row["image"], radius_mm)
        assert isinstance(found, Press), found
        presses.append(found)
    assert len(presses) == 67
    result = calibrate_gel(presses[::2], (0.0634, 0.0634), folds=4)  # half of them, for the time
    assert set(result.radius_error()) == {3.155, 4.75}
    assert all(abs(error) < 0.05 for error in result.radius_error().values()), result.radius_error()


def test_balls_of_two_sizes_determine_bulge_and_scale() -> None:
    rng = np.random.default_rng(4)
    moves = rng.uniform(-4, 4, (24, 2))
    radii = np.repeat([2.5, 5.0], 12)
    centres = (moves / (1.0 + radii[:, None] / 60.0)) / (0.058, 0.061) + 120.0
    centres = rng.normal(centres, 0.2)
    found = fit_scale(moves, centres, radii)
    assert found.mm_per_px == pytest.approx([0.058, 0.061], rel=0.02)
    assert found.pixel_aspect == pytest.approx(0.058 / 0.061, abs=4 * found.aspect_sigma)
    assert found.aspect_sigma < 0.005
    one_size = fit_scale(moves[:12], centres[:12], radii[:12])
    assert one_size.mm_per_px[0] == pytest.approx(0.058 * (1.0 + 2.5 / 60.0), rel=0.01)
