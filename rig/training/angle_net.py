"""AngleNet: a small ConvNeXt that estimates the angle of the object from one tactile image.

The paper compares with a larger network (section IV-D). Here it is replaced by the smallest ConvNeXt of timm
(zepto, 1.9 M parameters) on frames of reduced size.
"""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
from torch import nn
from torch.nn import functional

from drivers.types import Image
from rig.tactile.contact.network import frame_planes
from rig.tactile.peers.learned import load_image_network
from rig.training.export import check_agreement, export_half, onnx_model
from rig.training.lifts import GelViews
from rig.training.loop import EpochReport, fit
from rig.training.networks import declare_missing_operators
from rig.training.wrist import MOST_DIFFERENCE_DEG

BACKBONE = "convnext_zepto_rms"
SIZE = (72, 96)
"""(width, height) of its input in px."""
BATCH, RATE = 32, 2e-3
_ANGLE_DEG = 20.0
_GREY, _CONTRAST = 0.4, 0.2
"""Roughly mean and spread of a DIGIT's frame on a scale of 0 to 1."""
MOST_DIFFERENCE_HALF_DEG = 0.2
"""As `MOST_DIFFERENCE_DEG`, with weights stored in half precision."""
_TURN_DEG, _SHIFT, _LIGHT, _NOISE = 15.0, 0.06, 0.1, 2.0


class AngleNet(nn.Module):
    """Frames (N, 3, h, w), 0 to 1, to image angles (N,) in degrees."""

    def __init__(self) -> None:
        super().__init__()
        declare_missing_operators()
        import timm

        # without layer scale, which starts near zero: short trainings would end before the blocks contribute
        self.backbone = timm.create_model(BACKBONE, pretrained=False, num_classes=1, ls_init_value=None)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        return _ANGLE_DEG * self.backbone((planes - _GREY) / _CONTRAST)[:, 0]


def train_angle_net(
    train: GelViews, validation: GelViews, epochs: int, seed: int, augment: bool, report: EpochReport
) -> tuple[AngleNet, list[float]]:
    """Train; return the network of the best epoch, and the validation error of each epoch.

    augment: whether frames are rotated, shifted and relit each time they are used.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    # bfloat16 is not faster here, because most of the time is spent in depthwise convolutions
    network = AngleNet().to(memory_format=torch.channels_last)

    def loss(at: torch.Tensor) -> torch.Tensor:
        seen = [_augmented(train.images[i], float(train.angle_deg[i]), rng, augment) for i in at.tolist()]
        found = network(_planes([image for image, _ in seen]))
        return functional.l1_loss(found, torch.tensor([angle for _, angle in seen]))

    validate = partial(error_deg, network, validation)
    errors = fit(network, epochs, BATCH, RATE, len(train), loss, validate, report)
    return network, errors


def error_deg(network: AngleNet, views: GelViews) -> float:
    """Return the mean absolute error of single frames, without subtracting a zero."""
    starts = range(0, len(views), BATCH)
    with torch.inference_mode():
        found = [network(_planes(views.images[start : start + BATCH])).numpy() for start in starts]
    return float(np.abs(np.concatenate(found) - views.angle_deg).mean())


def export_angle_net(network: AngleNet, full: Path, half: Path) -> None:
    """Write a network in full precision and with half-precision weights. Raises `RigError` if they differ."""
    width, height = SIZE
    frame = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0))
    onnx.save(onnx_model(network, {"frame": frame}, ["angle_deg"]), full)
    export_half(full, half)
    image = (frame[0].numpy().transpose(1, 2, 0) * 255.0).astype(np.uint8)
    seen = torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32) / 255.0)
    with torch.inference_mode():
        own = network(seen).numpy()
    for path, most in ((full, MOST_DIFFERENCE_DEG), (half, MOST_DIFFERENCE_HALF_DEG)):
        check_agreement(path, load_image_network(path).angle_deg(image) - own, most, " deg")


def _planes(images: Sequence[Image] | Image) -> torch.Tensor:
    planes = torch.from_numpy(np.stack([frame_planes(image, SIZE) for image in images]))
    return planes.contiguous(memory_format=torch.channels_last)


def _augmented(
    image: Image, angle_deg: float, rng: np.random.Generator, augment: bool
) -> tuple[Image, float]:
    if not augment:
        return image, angle_deg
    turn = float(rng.uniform(-_TURN_DEG, _TURN_DEG))
    height, width = image.shape[:2]
    change = cv2.getRotationMatrix2D((width / 2.0, height / 2.0), turn, 1.0)
    change[:, 2] += rng.uniform(-_SHIFT, _SHIFT, 2) * (width, height)
    moved = cv2.warpAffine(image, change, (width, height), borderMode=cv2.BORDER_REFLECT)
    light = np.exp(rng.normal(0.0, _LIGHT, 3)) * math.exp(float(rng.normal(0.0, _LIGHT)))
    lit = moved * light + rng.normal(0.0, _NOISE, moved.shape)
    return np.clip(lit, 0.0, 255.0).astype(np.uint8), angle_deg + turn
