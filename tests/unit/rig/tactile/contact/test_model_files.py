"""ONNX files with weights in another file, and of a newer version."""

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from rig.tactile.contact.model_files import open_model
from support.onnx_bytes import FLOAT, field, model, node

SHAPE = (1, 1, 32, 32)


def stored_elsewhere(name: str, file: str) -> bytes:
    """Encode a tensor of float that another file has."""
    entry = field(13, field(1, "location") + field(2, file))
    return (
        b"".join(field(1, size) for size in SHAPE) + field(2, FLOAT) + field(8, name) + entry + field(14, 1)
    )


def write_model(path: Path, weights: str) -> Path:
    """Write a network that adds weights from another file to its input."""
    nodes = [node("Add", ["x", "w"], ["y"])]
    path.write_bytes(model(nodes, [stored_elsewhere("w", weights)], shapes=(SHAPE, SHAPE)))
    return path


def test_weights_in_another_file_of_the_folder_are_read(tmp_path: Path) -> None:
    weights = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
    (tmp_path / "net.onnx.data").write_bytes(weights.tobytes())
    session = open_model(write_model(tmp_path / "net.onnx", "net.onnx.data"), 1, "rig train")
    (found,) = session.run(None, {"x": np.zeros(SHAPE, np.float32)})
    assert np.array_equal(found, weights)


@pytest.mark.parametrize(
    ("weights", "why"),
    [
        ("gone.data", "'gone.data', which is missing"),
        ("../x.data", "'../x.data', which is not in its folder"),
    ],
)
def test_missing_weights_and_those_outside_the_folder_are_named(
    tmp_path: Path, weights: str, why: str
) -> None:
    (tmp_path / "x.data").write_bytes(bytes(4096))
    (tmp_path / "in").mkdir()
    path = write_model(tmp_path / "in" / "net.onnx", weights)
    with pytest.raises(InputError, match=f"net.onnx: its weights are in {why}: copy both files together"):
        open_model(path, 1, "rig train")


def test_file_of_a_newer_version_is_named_with_the_cure(tmp_path: Path) -> None:
    nodes = [node("Identity", ["x"], ["y"])]
    (tmp_path / "net.onnx").write_bytes(field(1, 99) + model(nodes, shapes=(SHAPE, SHAPE))[2:])
    with pytest.raises(
        InputError, match=r"has version 99 of ONNX's format, .* update onnxruntime, or export"
    ):
        open_model(tmp_path / "net.onnx", 1, "rig train")
