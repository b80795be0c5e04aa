"""A model card, and the network as ONNX in full, half and 8-bit precision; checkpoints become such files."""

import warnings
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process
from torch import nn

from drivers.errors import InputError, RigError
from rig.sessions.files import write_json
from rig.tactile.contact.network import METADATA_KEY, Recipe, load_network
from rig.training.examples import Examples
from rig.training.loop import plain_batches
from rig.training.networks import Architecture, build_network, load_weights

CARD, MODEL, HALF = "card.json", "model.onnx", "model.half.onnx"
OPSET = 18
STRIDE = 32
"""Image sides must be multiples of this: the encoders halve them five times."""
INPUT, OUTPUT = "planes", "logits"
CALIBRATION_FRAMES = 96
MOST_DIFFERENCE = 1e-4
"""Largest accepted difference between the library's logits and those of its ONNX file."""


def file_facts(path: Path) -> dict[str, str | int]:
    """Return name, size and hash of a file, as model cards list them."""
    data = path.read_bytes()
    return {"file": path.name, "bytes": len(data), "sha256": sha256(data).hexdigest()}


def check_agreement(path: Path, differences: NDArray[np.floating], most: float, unit: str = "") -> float:
    """Return the largest absolute difference between an exported file and its network.

    Raises `RigError` if it exceeds `most`.
    """
    worst = float(np.abs(differences).max())
    if not worst <= most:
        raise RigError(f"{path}: differs from its network by {worst:.2g}{unit}, more than {most:g}")
    return worst


def export_onnx(
    network: nn.Module, channels: int, size: tuple[int, int], recipe: Recipe, path: Path
) -> float:
    """Write a network as ONNX; return the largest difference of its logits from the library's own.

    size: (height, width). The recipe is stored in the file's metadata, so that nothing else is needed to run
    it. Raises `RigError` if the logits differ by more than `MOST_DIFFERENCE`.
    """
    planes = torch.rand(1, channels, *size, generator=torch.Generator().manual_seed(0))
    model = onnx_model(network, {INPUT: planes}, [OUTPUT])
    _describe(model, recipe)
    onnx.save(model, path)
    with torch.inference_mode():
        own = network(planes)[0, 0].numpy()
    return check_agreement(path, load_network(path).logits(planes[0].numpy()) - own, MOST_DIFFERENCE)


def onnx_model(
    network: nn.Module,
    inputs: dict[str, torch.Tensor],
    outputs: list[str],
    free: tuple[dict[int, object], ...] | None = None,
) -> onnx.ModelProto:
    """Return a network as ONNX, for inputs of exactly these shapes. Raises `RigError`.

    free: for each input, the axes of variable length (`torch.export.Dim`).
    """
    network.eval()
    with warnings.catch_warnings():
        # the exporter warns about its own internals
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            tuple(inputs.values()),
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=outputs,
            dynamic_shapes=free,
        )
    if program is None:
        raise RigError("the network could not be exported")
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]  # source locations on the training computer
    return model


def export_half(full: Path, path: Path) -> None:
    """Write a network with weights stored in half precision; it computes in full precision.

    Processors without half-precision arithmetic run it as fast as the full one, at half the size.
    """
    model = onnx.load(full)
    kept, casts = [], []
    for weight in model.graph.initializer:
        values = onnx.numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < 64:
            kept.append(weight)
            continue
        half = onnx.numpy_helper.from_array(values.astype(np.float16), weight.name + "_half")
        kept.append(half)
        casts.append(onnx.helper.make_node("Cast", [half.name], [weight.name], to=onnx.TensorProto.FLOAT))
    nodes = list(model.graph.node)
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(kept)
    model.graph.node.extend([*casts, *nodes])
    onnx.save(model, path)


def export_eight_bit(
    full: Path, examples: Examples, recipe: Recipe, size: tuple[int, int], path: Path
) -> None:
    """Write a network quantised to 8 bits, scaled by its activations on `CALIBRATION_FRAMES` frames."""
    prepared = path.with_name(path.name + ".prepared")
    quant_pre_process(str(full), str(prepared), skip_symbolic_shape=True)
    places = np.linspace(0, len(examples) - 1, min(CALIBRATION_FRAMES, len(examples))).astype(int)
    quantize_static(
        str(prepared),
        str(path),
        _Frames(examples.at(places), recipe, size),
        quant_format=QuantFormat.QDQ,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        per_channel=True,
    )
    prepared.unlink()
    model = onnx.load(path)
    _describe(model, recipe)
    onnx.save(model, path)


class _Frames(CalibrationDataReader):
    """Passes frames to the quantiser one by one."""

    def __init__(self, examples: Examples, recipe: Recipe, size: tuple[int, int]) -> None:
        self._batches = plain_batches(examples, recipe.inputs, size, 1)

    def get_next(self) -> dict[str, NDArray[np.float32]] | None:  # type: ignore[override] - None ends the data
        batch = next(self._batches, None)
        return None if batch is None else {INPUT: batch[0].numpy()}


def _describe(model: onnx.ModelProto, recipe: Recipe) -> None:
    del model.metadata_props[:]
    entry = onnx.StringStringEntryProto(key=METADATA_KEY, value=recipe.metadata())
    model.metadata_props.append(entry)


def import_checkpoint(
    checkpoint: Path, architecture: Architecture, encoder: str, size: tuple[int, int], threshold: float,
    out: Path,
) -> dict[str, Any]:  # fmt: skip
    """Write a checkpoint's network as ONNX with a card beside it; return the card.

    checkpoint: a state dict of segmentation-models-pytorch, bare or under `state_dict`. size: (height,
    width) in px of the images it was trained on. Raises `InputError`.
    """
    if any(side % STRIDE or not STRIDE <= side <= 2048 for side in size):
        raise InputError(f"--size {size[1]}x{size[0]}: give multiples of {STRIDE} px up to 2048")
    network = build_network(architecture, encoder)
    load_weights(network, checkpoint)
    if out.suffix != ".onnx":
        raise InputError(f"--out {out}: name it with the ending .onnx")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out.parent}: cannot be made ({error.strerror}): choose another --out") from error
    recipe = Recipe(architecture.inputs, threshold)
    difference = export_onnx(network, architecture.inputs.channels, size, recipe, out)
    card = {
        "name": out.stem,
        "title": architecture.title,
        "encoder": encoder if architecture.family else None,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "inputs": recipe.inputs.value,
        "size_px": [size[1], size[0]],
        "threshold": threshold,
        "label": "unknown: as in the checkpoint's training data",
        "data": f"unknown: imported from {checkpoint.name}",
        "largest_difference_from_library": difference,
        "files": {"fp32": file_facts(out)},
        "torch": str(torch.__version__),
    }
    write_json(out.with_suffix(".json"), card)
    return card
