"""Training of the network that finds turning texture."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError

torch = pytest.importorskip("torch", reason="training is the extra 'train'")


def test_trained_network_is_exported_and_loaded(tmp_path: Path) -> None:
    from rig.tactile.slip.turning import load_turning
    from rig.training.turning_net import train_turning

    result: list[tuple[str, float]] = []
    card = train_turning(tmp_path / "run", 6, 2, 1, 1, lambda text, share: result.append((text, share)))
    assert json.loads((tmp_path / "run" / "card.json").read_text(encoding="utf-8")) == card
    assert card["images"] == {"train": 30, "validation": 6}
    assert [share for text, share in result if text.startswith("turning: epoch")] == [0.5, 1.0]
    share = load_turning(tmp_path / "run" / "model.onnx").share(np.zeros((100, 80, 3), np.float32))
    assert share.shape == (50, 40)
    with pytest.raises(InputError, match="not empty"):
        train_turning(tmp_path / "run", 2, 1, 0, 1, lambda *_: None)
