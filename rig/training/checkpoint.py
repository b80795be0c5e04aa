"""Checkpoints of segmentation-models-pytorch, read without running code in them; `rig model import`."""

import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import nn

from drivers.errors import InputError, RigError
from drivers.formats import check_zip, reason
from rig.sessions.files import write_json
from rig.tactile.contact.network import Recipe
from rig.training.export import export_onnx, file_facts
from rig.training.networks import Architecture, build_network

_WRAPPERS = ("module.", "model.", "net.")
"""Prefixes that DataParallel and Lightning add to the names of weights."""
STRIDE = 32
"""Image sides must be multiples of this: the encoders halve them five times."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint's tensors and plain values. Raises `InputError`.

    Code inside a pickle is never run (`weights_only`), so files from untrusted sources are safe.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such checkpoint: check the path")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                check_zip(str(path), archive)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except RigError:  # the user interrupted the command
        raise
    except Exception as error:  # damaged files raise exceptions of any type in the three decoders
        why = reason(error)
        raise InputError(
            f"{path}: is not a complete PyTorch checkpoint of weights ({why}): copy it again, or save it "
            "again as a dictionary of tensors"
        ) from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: holds a {type(state).__name__}, not a dictionary with 'state_dict'")
    return state


def read_state(path: Path) -> dict[str, torch.Tensor]:
    """Return the weights under `state_dict`, or else of the whole file, without prefixes of wrappers."""
    checkpoint = read_checkpoint(path)
    inner = checkpoint.get("state_dict", checkpoint)
    if not isinstance(inner, dict):
        raise InputError(f"{path}: 'state_dict' is a {type(inner).__name__}, not a dictionary of tensors")
    weights = {str(key): value for key, value in inner.items() if isinstance(value, torch.Tensor)}
    if not weights:
        raise InputError(f"{path}: holds no weights (keys: {', '.join(map(str, list(inner)[:5]))})")
    for prefix in _WRAPPERS:
        if all(key.startswith(prefix) for key in weights):
            return {key.removeprefix(prefix): value for key, value in weights.items()}
    return weights


def fill_encoder(encoder: nn.Module, path: Path) -> None:
    """Load the weights of an encoder; ignore other weights in the file.

    Raises `InputError` if some of the encoder's weights are missing or have another shape.
    """
    state = read_state(path)
    # strict=False, which the library's encoders need, does not report missing weights
    counters = "num_batches_tracked"  # older files lack them, and inference does not use them
    lacking = [n for n in encoder.state_dict() if n not in state and not n.endswith(counters)]
    try:
        encoder.load_state_dict(state, strict=False)
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise InputError(f"{path}: does not fit the encoder ({first}): choose its own --encoder") from error
    if lacking:
        raise InputError(
            f"{path}: lacks {len(lacking)} of the encoder's weights ({', '.join(lacking[:3])} ...): "
            "choose the --encoder it was made with"
        )


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a checkpoint's weights into a network of the same architecture.

    Raises `InputError` naming weights that are missing, unknown or of another shape.
    """
    weights, own = read_state(path), network.state_dict()
    # normalisation statistics that Lightning scripts store beside the network
    weights = {key: value for key, value in weights.items() if key not in ("mean", "std")}
    missing = [key for key in own if key not in weights]
    unknown = [key for key in weights if key not in own]
    other = [key for key in own if key in weights and own[key].shape != weights[key].shape]
    for what, keys in (("lacks", missing), ("has unknown", unknown), ("has other shapes for", other)):
        if keys:
            raise InputError(
                f"{path}: {what} {len(keys)} of {len(own)} weights ({', '.join(keys[:3])} ...): "
                "choose the --arch and --encoder it was made with"
            )
    network.load_state_dict(weights)


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
