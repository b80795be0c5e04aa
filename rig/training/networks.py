"""The networks: the paper's three from segmentation-models-pytorch, and our own small one."""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional

from drivers.errors import InputError
from rig.tactile.network_input import NetworkInput

DEFAULT_ENCODER = "resnet18"
ENCODERS = ("resnet18", "efficientnet-b3")
OURS = "ours"


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
        Architecture(OURS, "ours", None, NetworkInput.FRAME_AND_DIFFERENCE, 0.5, (96, 80), (96, 80)),
    )
}


def find_architecture(name: str) -> Architecture:
    """Return an architecture by its name. Raises `InputError`."""
    if name not in ARCHITECTURES:
        raise InputError(f"there is no network '{name}': choose one of {', '.join(ARCHITECTURES)}")
    return ARCHITECTURES[name]


def build_network(architecture: Architecture, encoder: str = DEFAULT_ENCODER) -> nn.Module:
    """Make a network with random weights; it maps (N, C, H, W) float32 to logits (N, 1, H, W)."""
    if architecture.family is None:
        return SmallNetwork()
    if encoder not in ENCODERS:
        raise InputError(f"there is no encoder '{encoder}' here: choose one of {', '.join(ENCODERS)}")
    family = getattr(_library(), architecture.family)
    return family(encoder_name=encoder, encoder_weights=None, in_channels=3, classes=1)


class SmallNetwork(nn.Module):
    """Our network: an encoder and decoder with skip sums, 0.23 M parameters.

    Input (N, 6, H, W), H and W multiples of 16; logits (N, 1, H, W). Half of the resolution is
    folded into channels at the start and unfolded at the end (Shi et al. 2016), so that no layer
    works at full size; this is most of its speed.
    """

    def __init__(self, widths: tuple[int, int, int, int] = (16, 32, 48, 64)) -> None:
        super().__init__()
        full, half, quarter, eighth = widths
        self.fold = nn.PixelUnshuffle(2)
        self.level0 = _layer(6 * 4, full)
        self.level1 = nn.Sequential(_layer(full, half, stride=2), _layer(half, half))
        self.level2 = nn.Sequential(_layer(half, quarter, stride=2), _layer(quarter, quarter))
        # the dilated layer sees the whole frame: a contact's far side tells where its near side ends
        self.level3 = nn.Sequential(
            _layer(quarter, eighth, stride=2),
            _layer(eighth, eighth),
            _layer(eighth, eighth, dilation=2),
            _layer(eighth, eighth),
        )
        self.narrow2, self.join2 = nn.Conv2d(eighth, quarter, 1), _layer(quarter, quarter)
        self.narrow1, self.join1 = nn.Conv2d(quarter, half, 1), _layer(half, half)
        self.narrow0, self.join0 = nn.Conv2d(half, full, 1), _layer(full, full)
        self.head = nn.Conv2d(full, 4, 1)
        self.unfold = nn.PixelShuffle(2)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        """Return logits (N, 1, H, W)."""
        at0 = self.level0(self.fold(planes))
        at1 = self.level1(at0)
        at2 = self.level2(at1)
        up = self.join2(at2 + _grown(self.narrow2(self.level3(at2)), at2))
        up = self.join1(at1 + _grown(self.narrow1(up), at1))
        up = self.join0(at0 + _grown(self.narrow0(up), at0))
        return self.unfold(self.head(up))


def _layer(inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def _grown(planes: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return functional.interpolate(planes, size=like.shape[2:], mode="bilinear", align_corners=False)


def _library():
    """Import segmentation-models-pytorch where torch and torchvision do not match, too."""
    from rig.training.torchvision_operators import declare_missing_operators

    declare_missing_operators()
    import segmentation_models_pytorch

    return segmentation_models_pytorch
