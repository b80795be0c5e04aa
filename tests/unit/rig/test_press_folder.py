"""Folders of photographs of pressed balls, and the places that no press reaches."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.verdict import Verdict
from drivers.errors import InputError
from drivers.images import encode_png, load_image
from rig.benchmark.segmentation import read_presses
from rig.calibrate.kind import Samples
from rig.calibrate.press_folder import read_press_folder
from rig.calibrate.tactile import TactileOptions, solve_tactile, unpressed_fields
from rig.config.load import load_bench, parse_bench
from support.simulated_gel import SimulatedGel
from support.units import IN_MM, units

GEL = SimulatedGel(seed=3)
LOOK_BENCH = 'name = "desk"\n[[tactile]]\ndriver = "fake"\nserial = "S1"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "background.png").write_bytes(encode_png(np.rint(GEL.reference).astype(np.uint8)))
    for number, press in enumerate(GEL.presses(2)):
        (tmp_path / f"{number:06d}.png").write_bytes(encode_png(press.image))
    return tmp_path


def draw(folder: Path, circle: str) -> None:
    """Draw one circle by hand: the picture's number, then x, y and radius, px."""
    (folder / "circles.csv").write_text(f"frame,center_x,center_y,radius\n{circle}\n")


def test_every_picture_of_a_plain_folder_is_a_press_of_the_ball(folder: Path) -> None:
    presses = read_press_folder(folder, ball_mm=8.8)
    assert [press.id for press in presses.pressed] == ["000000.png", "000001.png"]
    assert {press.radius_mm for press in presses.pressed} == {4.4}
    with pytest.raises(InputError, match="give the diameter of the ball with --ball-mm"):
        read_press_folder(folder)


def test_circle_drawn_by_hand_replaces_the_one_that_was_found(folder: Path) -> None:
    draw(folder, "1,100,120,40")
    found, drawn = read_press_folder(folder, ball_mm=8.8).pressed
    assert drawn.circle == (100.0, 120.0, 40.0)
    assert found.circle != drawn.circle
    draw(folder, "1,100,120,-4")
    with pytest.raises(InputError, match="line 2: a circle's radius is -4 px"):
        read_press_folder(folder, ball_mm=8.8)


@pytest.mark.parametrize(
    ("circles", "said"),
    [
        ("7,100,120,40", "names no picture of"),
        ("1,100,120,40\n01,90,120,40", "line 3: 01 has a circle"),
    ],
)
def test_circles_of_no_picture_and_two_of_one_picture_are_rejected(
    folder: Path, circles: str, said: str
) -> None:
    draw(folder, circles)
    with pytest.raises(InputError, match=rf"circles\.csv.*{said}"):
        read_press_folder(folder, ball_mm=8.8)


def test_labels_of_presses_are_their_hand_drawn_circles(folder: Path) -> None:
    draw(folder, "1,100,120,40")
    presses = read_presses(folder)
    assert len(presses.frames) == 1
    rows, columns = np.nonzero(presses.labels[0])
    assert (columns.mean(), rows.mean()) == pytest.approx((100.0, 120.0))
    assert len(rows) == pytest.approx(np.pi * 40.0**2, rel=0.01)
    draw(folder, "7,100,120,40")
    with pytest.raises(InputError, match=r"circles\.csv: names no picture"):
        read_presses(folder)


def test_untouched_frames_are_read_from_their_folder(folder: Path, tmp_path: Path) -> None:
    untouched = tmp_path / "still"
    untouched.mkdir()
    for number in range(3):
        (untouched / f"{number}.png").write_bytes(encode_png(GEL.frame(np.random.default_rng(number))))
    assert len(read_press_folder(folder, 8.8, untouched=untouched).untouched) == 3
    assert read_press_folder(folder, 8.8).untouched == []
    (untouched / "3.png").write_bytes(encode_png(np.zeros((32, 24, 3), np.uint8)))
    with pytest.raises(InputError, match=r"still: has pictures of another size than .*background\.png"):
        read_press_folder(folder, 8.8, untouched=untouched)


def test_cells_without_a_press_are_named() -> None:
    everywhere = [(x, y, 45.0) for x in (40, 120, 200) for y in (40, 120, 200, 280)]
    assert unpressed_fields(everywhere, (320, 240)) == []
    assert unpressed_fields(everywhere[:-1], (320, 240)) == [(200.0, 280.0)]


def test_look_is_relative_to_its_bench_file(tmp_path: Path) -> None:
    path = tmp_path / "twin.toml"
    path.write_text(LOOK_BENCH + 'look = "calibrations/tactile-D1.npz"\n')
    assert load_bench(str(path)).tactile[0].look == str(tmp_path / "calibrations/tactile-D1.npz")
    with pytest.raises(InputError, match="no look is named"):
        parse_bench(LOOK_BENCH + "look_seed = 3\n", "bench.toml")


@pytest.mark.parametrize("copy", ["same row", "same picture", "compressed again", "shifted by a pixel"])
def test_repeated_press_counts_once(folder: Path, copy: str) -> None:
    picture = load_image(folder / "000000.png")
    assert picture is not None
    name = "000000.png" if copy == "same row" else "copy.png"
    if copy == "same picture":
        (folder / name).write_bytes((folder / "000000.png").read_bytes())
    elif copy == "compressed again":
        name = "copy.jpg"
        cv2.imwrite(str(folder / name), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
    elif copy == "shifted by a pixel":
        (folder / name).write_bytes(encode_png(np.roll(picture, 1, axis=1)))
    rows = ["image,diameter(mm)", "000000.png,8.8", "000001.png,8.8", f"{name},8.8"]
    (folder / "catalog.csv").write_text("\n".join(rows))
    presses = read_press_folder(folder)
    assert len(presses.pressed) == len(presses.found) == 2
    assert [(r.id, r.reason) for r in presses.rejected] == [(name, "same press as 000000.png")]


def test_circle_outside_its_picture_is_rejected(folder: Path) -> None:
    for centre in ("119,500", "300,100", "-4,100"):
        draw(folder, f"0,{centre},40")
        presses = read_press_folder(folder, ball_mm=8.8)
        assert [press.id for press in presses.pressed] == ["000001.png"]
        assert "outside the picture of 240 x 320 px" in presses.rejected[0].reason


@units
def test_ball_diameter_of_another_unit_is_refused(unit: str, folder: Path) -> None:
    diameter = 8.8 * IN_MM[unit]
    with pytest.raises(InputError, match=rf"fit a gel; in .*{unit}.*\?"):
        read_press_folder(folder, ball_mm=diameter)
    (folder / "catalog.csv").write_text(f"image,diameter(mm)\n000000.png,{diameter}\n")
    with pytest.raises(InputError, match=rf"line 2: .*; in .*{unit}.*\?"):
        read_press_folder(folder)


@units
def test_scale_of_a_gel_in_another_unit_is_refused(unit: str, folder: Path) -> None:
    scale = 0.06 * IN_MM[unit]
    found = solve_tactile(Samples(folder), TactileOptions(mm_per_px=(scale, scale), balls_mm=[8.8]))
    assert found.assessment.verdict is Verdict.REFUSED
    assert unit in str(found.assessment).split("; in ")[1]


@pytest.mark.parametrize("names", [("10.png", "9.png"), ("10.25.png", "9.5.png")])
def test_first_copy_by_number_counts(folder: Path, names: tuple[str, str]) -> None:
    (folder / "000001.png").unlink()
    (folder / "000000.png").rename(folder / names[0])
    (folder / names[1]).write_bytes((folder / names[0]).read_bytes())
    presses = read_press_folder(folder, ball_mm=8.8)
    assert [press.id for press in presses.pressed] == [names[1]]
    assert [r.reason for r in presses.rejected] == [f"same press as {names[1]}"]
