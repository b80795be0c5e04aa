"""`rig segment`, `rig label`, `rig model` and `rig train` as commands."""

import json
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import load_catalogue
from fakes.objects.surfaces import build_surface, depth_for_force
from support.command_line import answer, refusal_line, rig


def write(path: Path, rgb: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), rgb[..., ::-1])
    return path


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of ten presses of one unit, at places apart from one another."""
    folder = tmp_path_factory.mktemp("frames")
    unit, rng = GelSensor(77), np.random.default_rng(1)
    surface = build_surface(load_catalogue()["2"].sites[2], 1, 5)
    for number in range(10):
        turn = 0.6 * number
        place = (4.5 * float(np.cos(turn)), 6.5 * float(np.sin(turn)))
        depth_mm = depth_for_force(surface, 0.5, centre_mm=place)
        imprint = Imprint(surface, 20.0 * number, place, depth_mm)
        write(folder / f"{number}.png", unit.render(imprint, 0.1 * number, rng))
    return folder


@pytest.mark.heavy
@pytest.mark.parametrize("model", ["ours", "classical", "pspnet"])
def test_every_mask_has_the_size_of_its_image(model: str, frames: Path, tmp_path: Path) -> None:
    done = rig("segment", frames, "--model", model, "--out", tmp_path / "masks", "--json")
    figures = json.loads(done.stdout)
    assert len(figures["images"]) == 10
    assert figures["states"].get("contact", 0) >= 8
    for row in figures["images"]:
        mask = cv2.imread(row["mask"], cv2.IMREAD_UNCHANGED)
        assert mask.shape == (320, 240)
        assert set(np.unique(mask)) <= {0, 255}
        assert np.count_nonzero(mask) == row["area_px"]


def test_background_made_from_the_images_is_reported(frames: Path, tmp_path: Path) -> None:
    done = rig("segment", frames, "--background", "auto", "--out", tmp_path)
    assert "made from all frames (auto)" in done.stderr


def test_damaged_black_and_saturated_images_are_flagged(frames: Path, tmp_path: Path) -> None:
    black = write(tmp_path / "in" / "black.png", np.zeros((320, 240, 3), np.uint8))
    white = write(tmp_path / "in" / "white.png", np.full((320, 240, 3), 255, np.uint8))
    cut = tmp_path / "in" / "cut.png"
    cut.write_bytes((frames / "0.png").read_bytes()[:3000])
    done = rig("segment", black, white, cut, "--background", frames / "0.png", "--out", tmp_path, "--json")
    rows = json.loads(done.stdout)["images"]
    assert [row["state"] for row in rows] == ["black", "saturated", "unreadable"]
    assert not cv2.imread(str(tmp_path / "black.png"), cv2.IMREAD_UNCHANGED).any()
    assert rows[2]["mask"] is None
    assert "cut.png: unreadable" in done.stderr


@pytest.mark.heavy
def test_invalid_input_is_a_one_line_error(frames: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "small" / "0.png", np.full((64, 48, 3), 90, np.uint8))
    text = tmp_path / "notes.png"
    text.write_text("no image")
    out = ("--out", tmp_path / "out")
    assert "no such" in refusal_line("segment", tmp_path / "none", *out)
    assert "--background" in refusal_line("segment", frames / "0.png", *out)
    assert "would both become" in refusal_line("segment", frames / "0.png", other, "--model", "pspnet", *out)
    assert "replace the image" in refusal_line("segment", frames, "--out", frames)
    assert "one size" in refusal_line("segment", frames / "1.png", "--background", other, *out)
    assert "best: network not found" in refusal_line("segment", frames, "--model", "best", *out)
    assert "none of the images can be read" in refusal_line("segment", text, "--model", "pspnet", *out)


@pytest.mark.heavy
def test_manual_corrections_are_kept_and_exported(frames: Path, tmp_path: Path) -> None:
    first = rig("label", frames, "--out", tmp_path, "--json")
    assert json.loads(first.stdout)["proposed"] == 10
    corrected = tmp_path / "3.json"
    document = json.loads(corrected.read_text())
    assert (corrected.parent / document["imagePath"]).resolve() == (frames / "3.png").resolve()
    document["shapes"] = [{"label": "contact", "points": [[10, 10], [50, 10], [50, 90], [10, 90]]}]
    corrected.write_text(json.dumps(document))
    again = rig("label", frames, "--out", tmp_path, "--json")
    assert json.loads(again.stdout) | {"labels": []} == {
        "out": str(tmp_path),
        "model": "classical",
        "proposed": 0,
        "kept": 10,
        "labels": [],
    }
    mask = cv2.imread(str(tmp_path / "masks" / "3.png"), cv2.IMREAD_UNCHANGED)
    assert np.count_nonzero(mask) == 40 * 80
    coco = json.loads((tmp_path / "coco.json").read_text())
    assert sorted(round(note["area"]) for note in coco["annotations"]).count(3200) == 1


def test_shipped_networks_are_listed() -> None:
    models = answer("model", "list")["models"]
    assert [model["name"] for model in models] == ["ours", "ours-full", "pspnet"]
    assert "SIMULATED" in rig("model", "list").stdout


@pytest.mark.skipif(find_spec("torch") is not None, reason="extra `train` is installed")
def test_training_without_its_extra_names_the_package_to_install(tmp_path: Path) -> None:
    assert "[train]" in refusal_line("train", "--out", tmp_path / "run")
    assert "[train]" in refusal_line("model", "import", "a.pth", "--out", tmp_path / "a.onnx")
