"""Examples of turning contacts agree with the drawn contacts, and the network is trained on them."""

import json
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from calibration.gel.look import SLOPE_TERMS, GelLook
from calibration.gel.noise import CameraNoise
from drivers.errors import InputError
from drivers.types import Image
from fakes.studio.training_frames import LOOK_SEEDS_FROM, training_frames
from rig.config.devices import FakeTactileConfig
from turning_examples import SIZE, TURN_DEG, TurningFrame, example_of, turning_examples, turning_frames

HEIGHT, WIDTH = 320, 240
CENTER_PX = (119.5, 159.5)
_Y, _X = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)


def _scene(turn_deg: float) -> np.ndarray:
    """A ring that rests and a bar that turns about its middle, as a clean change in grey levels."""
    turn = np.deg2rad(turn_deg)
    x, y = _X - CENTER_PX[0], _Y - CENTER_PX[1]
    along, across = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    bar = 40.0 * np.exp(-((across / 4.0) ** 2)) * (np.abs(along) < 50.0)
    ring = 40.0 * np.exp(-(((np.hypot(x, y) - 85.0) / 4.0) ** 2))
    ring = ring * (1.0 + 0.3 * np.sin(3.0 * np.arctan2(y, x)))
    return np.repeat((bar + ring)[..., None], 3, axis=2).astype(np.float32)


def _shown() -> TurningFrame:
    background = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    before, after = _scene(20.0), _scene(20.0 + TURN_DEG)
    image: Image = np.clip(background + before, 0, 255).astype(np.uint8)
    return TurningFrame(image, background, before, after, CENTER_PX, 1.0)


def test_bar_turns_and_ring_does_not() -> None:
    difference, share, weight = example_of(_shown())
    assert difference.shape == (160, 120, 3)
    y, x = np.mgrid[:160, :120] * 2.0 + 0.5
    radius = np.hypot(x - CENTER_PX[0], y - CENTER_PX[1])
    bar, ring = (radius > 15.0) & (radius < 45.0) & (weight > 0.5), (radius > 70.0) & (weight > 0.5)
    assert bar.sum() > 100
    assert ring.sum() > 100
    assert share[bar].mean() > 0.8
    assert share[ring].mean() < 0.2
    assert share[weight < 0.04].max() == pytest.approx(0.0)


@pytest.mark.heavy
def test_examples_have_the_network_input_and_output_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("turning_examples._FACES_PER_TASK", 1)
    result: list[int] = []
    examples = turning_examples(2, 7, result.append)
    assert result == [1, 2]
    assert examples.differences.shape == (12, 3, SIZE[1], SIZE[0])
    assert examples.shares.shape == examples.weights.shape == (12, SIZE[1] // 2, SIZE[0] // 2)
    assert 0.0 <= examples.shares.min() < examples.shares.max() <= 1.0 + 1e-5
    assert examples.weights.min() > 0.0


@pytest.mark.heavy
def test_every_second_sensor_is_a_variation_of_the_look() -> None:
    reach = np.zeros((13, 13, 12, 12))
    flat = np.full((320, 240, 3), 100.0, np.float32)
    look = GelLook(
        flat, np.full((SLOPE_TERMS, 3), 20.0), 0, False, False, (0.05, 0.05), CameraNoise(reach), None
    )
    units = [frames[0].background for frames in islice(turning_frames(11, look), 8)]
    in_the_look = sum(bool(background.std((0, 1)).max() < 2.0) for background in units)
    assert 1 <= in_the_look <= 7


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["train", "turning"])
def test_training_varies_looks_by_seeds_that_no_bench_accepts(kind: str) -> None:
    seeds: list[int] = []
    look: Any = SimpleNamespace(varied=seeds.append)
    units = training_frames(["1"], 3, look=look) if kind == "train" else turning_frames(3, look)
    for _ in islice(units, 6):
        pass
    assert len(seeds) >= 2
    assert min(seeds) >= LOOK_SEEDS_FROM
    sensor = {"driver": "fake", "serial": "S1", "look": "tactile-S1.npz"}
    FakeTactileConfig.model_validate({**sensor, "look_seed": LOOK_SEEDS_FROM - 1})
    with pytest.raises(ValidationError, match="look_seed"):
        FakeTactileConfig.model_validate({**sensor, "look_seed": LOOK_SEEDS_FROM})


def test_trained_network_is_exported_and_loaded(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training is the extra 'train'")
    from rig.tactile.slip.turning import load_turning
    from turning_net import train_turning

    result: list[tuple[str, float]] = []
    card = train_turning(tmp_path / "run", 6, 2, 1, 1, lambda text, share: result.append((text, share)))
    assert json.loads((tmp_path / "run" / "card.json").read_text(encoding="utf-8")) == card
    assert card["images"] == {"train": 30, "validation": 6}
    assert [share for text, share in result if text.startswith("turning: epoch")] == [0.5, 1.0]
    share = load_turning(tmp_path / "run" / "model.onnx").share(np.zeros((100, 80, 3), np.float32))
    assert share.shape == (50, 40)
    with pytest.raises(InputError, match="not empty"):
        train_turning(tmp_path / "run", 2, 1, 0, 1, lambda *_: None)
