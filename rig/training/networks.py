"""The networks: the paper's three from segmentation-models-pytorch, and our own small one."""

import importlib.util
from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional

from drivers.errors import unknown_name
from rig.tactile.contact.network import NetworkInput

# schemas that torchvision's import needs: torchvision/csrc/ops/nms.cpp, quantized/cpu/qnms_kernel.cpp
_SCHEMAS = [f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor" for name in ("nms", "qnms")]
_declared: list[torch.library.Library] = []
DEFAULT_ENCODER = "resnet18"
ENCODERS = ("resnet18", "efficientnet-b3")
OURS = "ours"
PATCH_PX = 4


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
        up = self.join2(at2 + _grown(self.narrow2(self.level3(at2)), at2))
        up = self.join1(at1 + _grown(self.narrow1(up), at1))
        return self.head(up)


def layer(inputs: int, outputs: int, side: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """Return a `side` x `side` convolution with padding, followed by normalisation and ReLU."""
    padding = dilation * ((side - stride + 1) // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, padding, dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def _grown(planes: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return functional.interpolate(planes, size=like.shape[2:], mode="bilinear", align_corners=False)
