"""The networks: the paper's three from segmentation-models-pytorch, our own small one, and their weights.

Checkpoints of segmentation-models-pytorch are read without running code in them.
"""

import importlib.util
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.nn import functional

from drivers.errors import InputError, RigError, unknown_name
from drivers.formats import check_zip, reason
from rig.tactile.contact.network import NetworkInput

# schemas that torchvision's import needs: torchvision/csrc/ops/nms.cpp, quantized/cpu/qnms_kernel.cpp
_SCHEMAS = [f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor" for name in ("nms", "qnms")]
_declared: list[torch.library.Library] = []
DEFAULT_ENCODER = "resnet18"
ENCODERS = ("resnet18", "efficientnet-b3")
OURS = "ours"
PATCH_PX = 4
_WRAPPERS = ("module.", "model.", "net.")
"""Prefixes that DataParallel and Lightning add to the names of weights."""


def declare_missing_operators() -> None:
    """Make torchvision importable beside a torch it was not built for, by declaring operators it lacks.

    segmentation-models-pytorch needs timm, which imports torchvision. A torchvision built for CUDA cannot be
    imported beside a CPU build of torch ("operator torchvision::nms does not exist"). Only its compiled
    detection operators are missing, which segmentation never calls. If the builds match, nothing is declared.
    """
    if _declared or importlib.util.find_spec("torchvision") is None:
        return
    try:
        import torchvision  # noqa: F401
    except RuntimeError as error:
        if "torchvision::" not in str(error):
            raise
        library = torch.library.Library("torchvision", "FRAGMENT")
        for schema in _SCHEMAS:
            library.define(schema)
        _declared.append(library)  # the declarations end with the object


@dataclass(frozen=True, slots=True)
class Architecture:
    """A network by its name on the command line.

    family: class in segmentation-models-pytorch, None for ours. threshold: on the sigmoid (paper, section
    III-A: 0.7). size: (height, width) in px in the reduced and in the paper's setting.
    """

    name: str
    title: str
    family: str | None
    inputs: NetworkInput
    threshold: float
    size: tuple[int, int]
    paper_size: tuple[int, int]


_SIZES = ((160, 128), (320, 256))
ARCHITECTURES = {
    a.name: a
    for a in (
        Architecture("pspnet", "PSPNet", "PSPNet", NetworkInput.FRAME, 0.7, *_SIZES),
        Architecture("deeplabv3plus", "DeepLabV3+", "DeepLabV3Plus", NetworkInput.FRAME, 0.7, *_SIZES),
        Architecture("unetplusplus", "UNet++", "UnetPlusPlus", NetworkInput.FRAME, 0.7, *_SIZES),
        Architecture(OURS, "ours", None, NetworkInput.FRAME_AND_DIFFERENCE, 0.5, (128, 96), (128, 96)),
    )
}


def find_architecture(name: str) -> Architecture:
    if name not in ARCHITECTURES:
        raise unknown_name("network", name, ARCHITECTURES)
    return ARCHITECTURES[name]


def build_network(architecture: Architecture, encoder: str = DEFAULT_ENCODER) -> nn.Module:
    """Make a network with random weights; it maps (N, C, H, W) float32 to logits (N, 1, H, W)."""
    if architecture.family is None:
        return SmallNetwork()
    if encoder not in ENCODERS:
        raise unknown_name("encoder", encoder, ENCODERS)
    declare_missing_operators()
    import segmentation_models_pytorch

    family = getattr(segmentation_models_pytorch, architecture.family)
    return family(encoder_name=encoder, encoder_weights=None, in_channels=3, classes=1)


class SmallNetwork(nn.Module):
    """Our network: an encoder and decoder with additive skip connections, 0.24 M parameters.

    Input (N, 6, H, W), H and W multiples of 16; logits (N, 1, H, W). The first layer reduces and the last one
    restores the resolution by 4 in each direction, so no layer between them works at full size. This gives
    most of its speed.
    """

    def __init__(self) -> None:
        super().__init__()
        quarter, eighth, sixteenth = 32, 48, 64
        self.level1 = nn.Sequential(layer(6, quarter, 8, stride=PATCH_PX), layer(quarter, quarter))
        self.level2 = nn.Sequential(layer(quarter, eighth, stride=2), layer(eighth, eighth))
        # the dilated layer extends the receptive field to the whole frame
        self.level3 = nn.Sequential(
            layer(eighth, sixteenth, stride=2),
            layer(sixteenth, sixteenth),
            layer(sixteenth, sixteenth, dilation=2),
            layer(sixteenth, sixteenth),
        )
        self.narrow2, self.join2 = nn.Conv2d(sixteenth, eighth, 1), layer(eighth, eighth)
        self.narrow1 = nn.Conv2d(eighth, quarter, 1)
        self.join1 = nn.Sequential(layer(quarter, quarter), layer(quarter, quarter))
        self.head = nn.ConvTranspose2d(quarter, 1, PATCH_PX, PATCH_PX)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        at1 = self.level1(planes)
        at2 = self.level2(at1)
        up = self.join2(at2 + _enlarge(self.narrow2(self.level3(at2)), at2))
        up = self.join1(at1 + _enlarge(self.narrow1(up), at1))
        return self.head(up)


def layer(inputs: int, outputs: int, side: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """Return a `side` x `side` convolution with padding, followed by normalisation and ReLU."""
    padding = dilation * ((side - stride + 1) // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, padding, dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def _enlarge(planes: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return functional.interpolate(planes, size=like.shape[2:], mode="bilinear", align_corners=False)


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
