"""Published checkpoints brought to ONNX: `rig model import`."""

from pathlib import Path
from typing import Any

import torch

from drivers.errors import InputError
from rig.sessions.files import write_json
from rig.tactile.contact.network import Recipe
from rig.training.checkpoint import load_weights
from rig.training.export import ExportedFile, export_onnx
from rig.training.networks import Architecture, build_network

STRIDE = 32
"""Sides of images that every encoder can halve five times."""


def import_checkpoint(
    checkpoint: Path,
    architecture: Architecture,
    encoder: str,
    size: tuple[int, int],
    threshold: float,
    out: Path,
) -> dict[str, Any]:
    """Write a checkpoint's network as ONNX with a card beside it; return the card.

    checkpoint: a state dict of segmentation-models-pytorch, bare or under `state_dict`. size: (height,
    width) in px of the images it was trained on. Raises `InputError`.
    """
    if any(side % STRIDE or not STRIDE <= side <= 2048 for side in size):
        raise InputError(f"--size {size[1]}x{size[0]}: give multiples of {STRIDE} px up to 2048")
    network = build_network(architecture, encoder)
    load_weights(network, checkpoint)
    _make_parent(out)
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
        "files": {"fp32": ExportedFile("fp32", out).facts()},
        "torch": str(torch.__version__),
    }
    write_json(out.with_suffix(".json"), card)
    return card


def _make_parent(out: Path) -> None:
    if out.suffix != ".onnx":
        raise InputError(f"--out {out}: name it with the ending .onnx")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out.parent}: cannot be made ({error.strerror}): choose another --out") from error
