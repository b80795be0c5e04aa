"""Checkpoints of segmentation-models-pytorch, read without running what is in them."""

import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import nn

from drivers.errors import InputError, RigError
from drivers.formats import reason

_WRAPPERS = ("module.", "model.", "net.")
"""What DataParallel and Lightning put before the names of weights."""
_MOST_RATIO = 20
"""How much larger an archive may be unpacked."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint's tensors and plain values. Raises `InputError`.

    Code inside a pickle is never run (`weights_only`), so a file from anywhere is safe to try.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such checkpoint: check the path")
    try:
        _refuse_packed(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except RigError:  # a stop that came meanwhile
        raise
    except Exception as error:  # damage ends in any of the errors of three decoders
        why = reason(error)
        raise InputError(
            f"{path}: is no complete PyTorch checkpoint of weights ({why}): copy it anew, or save it again "
            "as a dictionary of tensors"
        ) from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: holds a {type(state).__name__}, not a dictionary with 'state_dict'")
    return state


def _refuse_packed(path: Path) -> None:
    """Raise `ValueError` for an archive that stands for more than it holds; weights are not packed."""
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    if unpacked > _MOST_RATIO * path.stat().st_size:
        raise ValueError(f"{unpacked / 1e6:.0f} MB unpacked, more than is read")


def read_state(path: Path) -> dict[str, torch.Tensor]:
    """Return the weights under `state_dict`, or of the whole file, without wrappers' prefixes."""
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
    """Put weights into an encoder; others in the file are left out.

    Raises `InputError` for a file that lacks some of the encoder's, or has them of another shape.
    """
    state = read_state(path)
    # the library's encoders do not say themselves what is missing
    counters = "num_batches_tracked"  # older files have none, and nothing needs them
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
    """Put a checkpoint's weights into a network of the same make.

    Raises `InputError` naming what is missing, unknown or of another shape.
    """
    weights, own = read_state(path), network.state_dict()
    # statistics of normalisation kept beside the network, as Lightning scripts do
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
