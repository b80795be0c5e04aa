"""Networks that need much memory are refused by name: declared tensors when opened, others when run."""

import resource
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import FormatError, InputError
from drivers.formats import check_onnx
from rig.tactile.contact.network import load_network
from support.onnx_bytes import field, node, segmentation, sparse, tensor, varint

SIDE = 60_000
"""A square of floats with this side takes 14 GB."""
IF_GRAPH = field(1, node("Constant", [], ["z"], field(1, "value") + field(5, tensor("z", [SIDE, SIDE]))))
DECLARED = {
    "sparse initializer": segmentation([], more=field(15, sparse("big", [SIDE, SIDE]))),
    "sparse constant": segmentation(
        [node("Constant", [], ["big"], field(1, "sparse_value") + field(22, sparse("", [SIDE, SIDE])))]
    ),
    "initializer without data": segmentation([], [tensor("big", [SIDE, SIDE])]),
    "packed dimensions": segmentation([], [tensor("big", [SIDE, SIDE], packed=True)]),
    "overflowing dimensions": segmentation([], [tensor("big", [1 << 33, 1 << 33, 1 << 62])]),
    "negative dimension": segmentation([], [tensor("big", [(1 << 64) - 1])]),
    "tensor in a branch": segmentation(
        [node("If", ["x"], ["big"], field(1, "then_branch") + field(6, IF_GRAPH) + field(20, 5))]
    ),
    "behind an unknown group": varint(100 << 3 | 3)
    + varint(100 << 3 | 4)
    + segmentation([], more=field(15, sparse("big", [SIDE, SIDE]))),
    "dimensions in two parts": segmentation(
        [
            node(
                "Constant",
                [],
                ["big"],
                field(1, "sparse_value") + field(22, sparse("", [SIDE])) + field(22, field(3, SIDE)),
            )
        ]
    ),
    "many small ones": segmentation([], [tensor(f"t{n}", [4_000_000]) for n in range(20)]),
}
SQUARE, LINE = tensor("shape", [2], whole=[SIDE, SIDE]), bytes(4 * SIDE)
ONE, CELL = tensor("one", [1], bytes(4)), tensor("one", [1, 1], bytes(4))
GROWING = {
    "ConstantOfShape": segmentation([node("ConstantOfShape", ["shape"], ["big"])], [SQUARE]),
    "Expand": segmentation([node("Expand", ["one", "shape"], ["big"])], [SQUARE, ONE]),
    "Tile": segmentation([node("Tile", ["one", "shape"], ["big"])], [SQUARE, CELL]),
    "outer sum": segmentation(
        [node("Add", ["a", "b"], ["big"])], [tensor("a", [SIDE, 1], LINE), tensor("b", [1, SIDE], LINE)]
    ),
    "Resize": segmentation(
        [node("Resize", ["x", "", "scales"], ["big"])],
        [tensor("scales", [4], np.array([1, 1, 2000, 2000], np.float32).tobytes())],
    ),
}


def stored(folder: Path, data: bytes) -> Path:
    path = folder / "bomb.onnx"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("kind", DECLARED)
def test_network_with_large_declared_tensors_is_refused_before_it_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("opened"))
    with pytest.raises(FormatError, match=r"bomb\.onnx: 0\.00 MB become \d+ MB or more when decompressed"):
        load_network(stored(tmp_path, DECLARED[kind]))


@pytest.mark.parametrize("kind", GROWING)
def test_network_with_large_intermediate_results_is_refused_without_taking_memory(
    tmp_path: Path, kind: str
) -> None:
    network = load_network(stored(tmp_path, GROWING[kind]))
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"bomb\.onnx: (needs|.* Tile output tensor would require) more"):
        network.logits(np.zeros((3, 32, 32), np.float32))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200_000


def test_small_sparse_tensor_is_accepted(tmp_path: Path) -> None:
    network = load_network(stored(tmp_path, segmentation([], more=field(15, sparse("big", [300, 300])))))
    image = np.random.default_rng(1).random((3, 32, 32), np.float32)
    assert np.array_equal(network.logits(image), image[0])


def test_damaged_file_is_counted_up_to_its_damage() -> None:
    bomb, small, rng = DECLARED["sparse initializer"], segmentation([]), np.random.default_rng(0)
    with pytest.raises(FormatError):
        check_onnx(Path("x"), bomb)
    for end in range(len(bomb)):
        with suppress(FormatError):
            check_onnx(Path("x"), bomb[:end])
    for _ in range(300):
        damaged = bytearray(small)
        damaged[rng.integers(len(damaged))] = int(rng.integers(256))
        with suppress(FormatError):
            check_onnx(Path("x"), bytes(damaged))
        check_onnx(Path("x"), rng.bytes(20)[:1] + bytes(20))
