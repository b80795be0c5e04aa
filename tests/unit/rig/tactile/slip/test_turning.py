"""The shipped network separates turning texture from texture at rest."""

import json
from hashlib import sha256
from importlib.resources import as_file
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from rig.tactile.contact.model_files import MODELS
from rig.tactile.slip.parameters import KEYFRAMES
from rig.tactile.slip.turning import SHARE_PX, load_turning, shipped_turning
from turning_examples import example_of, turning_frames

UNSEEN = 90_001


@pytest.mark.heavy
def test_shipped_network_separates_turning_from_resting_on_unseen_faces() -> None:
    drawn, network = turning_frames(UNSEEN), shipped_turning()
    result, true, weights = [], [], []
    for shown in (frame for _ in range(12) for frame in next(drawn)[:2]):
        difference, share, weight = example_of(shown)
        wide = network.share(difference).repeat(SHARE_PX, 0).repeat(SHARE_PX, 1)
        result.append(wide[: share.shape[0], : share.shape[1]])
        true.append(share)
        weights.append(weight)
    found, known, weight = (np.concatenate([a.ravel() for a in arrays]) for arrays in (result, true, weights))
    turns, rests = weight * (known > 0.8), weight * (known < 0.2)
    assert turns.sum() > 1000.0
    assert rests.sum() > 1000.0
    # Where all of it counted alike, both means would be equal.
    assert (found @ turns) / turns.sum() > 0.65
    assert (found @ rests) / rests.sum() < 0.30


def test_card_matches_the_shipped_file() -> None:
    card = json.loads((MODELS / "turning.json").read_text(encoding="utf-8"))
    assert card["files"]["fp32"]["sha256"] == sha256((MODELS / "turning.onnx").read_bytes()).hexdigest()
    assert card["simulated"]


SIZES = [(160, 120, 2), (117, 158, 2), (80, 60, 1), (53, 81, 1)]


@pytest.mark.parametrize(("height", "width", "scale"), SIZES)
def test_any_image_size_is_processed(height: int, width: int, scale: int) -> None:
    difference = np.random.default_rng(1).normal(0.0, 0.1, (3, height, width)).astype(np.float32)
    counts = shipped_turning().counts(difference, scale)
    assert counts.shape == (height, width)
    assert counts.dtype == np.float32
    assert KEYFRAMES.least_count - 1e-6 <= counts.min() <= counts.max() <= 1.0 + 1e-6


def test_files_of_other_networks_are_refused(tmp_path: Path) -> None:
    for other in ("toskov", "anglenet", "ours"):
        with as_file(MODELS / f"{other}.onnx") as path, pytest.raises(InputError, match=r"train_turning\.py"):
            load_turning(path)
    (tmp_path / "cut.onnx").write_bytes((MODELS / "turning.onnx").read_bytes()[:500])
    with pytest.raises(InputError, match=r"cut\.onnx"):
        load_turning(tmp_path / "cut.onnx")
