"""The network that estimates which texture of a contact turns with the object, and its training.

To train it, run `python tools/train_turning.py --help`.
"""

import math
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import nn
from torch.nn import functional

from calibration.gel.look import load_look
from fitting import claim_folder, fit
from rig.sessions.files import write_json
from rig.tactile.slip.turning import MULTIPLE_PX, SHARE_PX, load_turning
from rig.training.export import CARD, MODEL, check_agreement, file_facts, onnx_model
from rig.training.loop import Report
from rig.training.networks import layer
from turning_examples import FRAMES_PER_FACE, TurningExamples, turning_examples

BATCH, RATE = 128, 3e-3
_VALIDATED = 0.05
"""Share of the faces on which the best epoch is chosen."""
_CLIPPED, _UNIT = 6.0, 0.125
"""Relative differences are divided by `_UNIT` and clipped."""
_PLANES = (12, 24, 48, 96)
_TURNED, _SCALED, _MIXED, _NEGATIVE = 0.6, 0.25, 0.25, 0.2
_FAINTEST, _STRONGEST, _NOISE = math.log(0.2), math.log(1.6), 0.006
_UNEVEN, _SOFTENED = 0.2, 0.25
"""Standard deviation of the log of the light over the gel, and fraction of the images that are softened."""
_MOST_DIFFERENCE = 1e-3


class TurningNet(nn.Module):
    """Relative differences (N, 3, h, w), sides multiples of `MULTIPLE_PX`, to logits (N, 1, h / 2, w / 2).

    Features of four scales are added, because a line at the rim of a bulge is recognised only by its
    surroundings.
    """

    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = _PLANES
        self.halved = layer(3, first, stride=2)
        self.quarter = nn.Sequential(layer(first, second, stride=2), _Residual(second))
        self.eighth = nn.Sequential(layer(second, third, stride=2), _Residual(third))
        self.sixteenth = nn.Sequential(layer(third, fourth, stride=2), _Residual(fourth))
        self.to_third, self.to_second = nn.Conv2d(fourth, third, 1), nn.Conv2d(third, second, 1)
        self.at_eighth, self.at_quarter = layer(third, third), layer(second, second)
        self.upscaled = nn.Sequential(nn.Conv2d(second, 4, 1), nn.PixelShuffle(2))

    def forward(self, differences: torch.Tensor) -> torch.Tensor:
        quarter = self.quarter(self.halved(torch.clamp(differences / _UNIT, -_CLIPPED, _CLIPPED)))
        eighth = self.eighth(quarter)
        eighth = self.at_eighth(_double(self.to_third(self.sixteenth(eighth))) + eighth)
        return self.upscaled(self.at_quarter(_double(self.to_second(eighth)) + quarter))


class _Residual(nn.Module):
    """Adds two convolutions to their input."""

    def __init__(self, planes: int) -> None:
        super().__init__()
        second = nn.Conv2d(planes, planes, 3, padding=1, bias=False), nn.BatchNorm2d(planes)
        self.added = nn.Sequential(layer(planes, planes), *second)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        return functional.relu(planes + self.added(planes))


def train_turning(
    out: Path,
    faces: int,
    epochs: int,
    seed: int,
    threads: int | None,
    report: Report,
    look: Path | None = None,
) -> dict[str, Any]:
    """Train the network; write model and card into an empty folder, and return the card.

    faces: number of rendered faces, at least 2; every twentieth validates. threads: of torch, None for its
    default. look: of a real unit, whose variations are every second sensor. Raises `InputError` if the folder
    is not empty or cannot be made.
    """
    unit = None if look is None else load_look(look)
    claim_folder(out, threads)
    torch.manual_seed(seed)
    jobs = threads or os.cpu_count() or 1
    examples = turning_examples(faces, seed, lambda n: report("SIMULATED contacts", n / faces), unit, jobs)
    kept = FRAMES_PER_FACE * (faces - max(1, round(faces * _VALIDATED)))
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network = TurningNet().to(device, memory_format=torch.channels_last)
    generator = torch.Generator(device).manual_seed(seed)

    def loss(at: torch.Tensor) -> torch.Tensor:
        planes, shares, weights = _augment(*_batch(examples, at.numpy(), device), generator)
        losses = functional.binary_cross_entropy_with_logits(network(planes), shares, reduction="none")
        return (losses * weights).sum() / weights.sum()

    validation = np.arange(kept, len(examples))
    validate = partial(error_of, network, examples, validation)
    shown = "turning: {epoch}, loss {loss:.3f}, validation {error:.3f}"
    errors = fit(network, epochs, BATCH, RATE, kept, loss, validate, report, shown)
    export_turning(network.cpu(), out / MODEL)
    card: dict[str, Any] = {
        "name": "turning",
        "title": "what of a contact's texture turns with the object",
        "data": "simulated contacts"
        if look is None
        else f"simulated contacts, in varied forms of {look.name}",
        "simulated": True,
        "faces": faces,
        "images": {"train": kept, "validation": len(examples) - kept},
        "seed": seed,
        "epochs": epochs,
        "parameters": sum(p.numel() for p in network.parameters()),
        "validation_error": errors,
        "files": {"fp32": file_facts(out / MODEL)},
        "torch": str(torch.__version__),
    }
    write_json(out / CARD, card)
    return card


def error_of(network: nn.Module, examples: TurningExamples, at: np.ndarray) -> float:
    """Return the mean absolute error of a network's share, weighted by the strength of the texture."""
    error, total = 0.0, 0.0
    device = next(network.parameters()).device
    with torch.inference_mode():
        for start in range(0, len(at), BATCH):
            planes, shares, weights = _batch(examples, at[start : start + BATCH], device)
            found = torch.sigmoid(network(_pad(planes))[..., : shares.shape[2], : shares.shape[3]])
            error += float((weights * (found - shares).abs()).sum())
            total += float(weights.sum())
    return error / total


def export_turning(network: nn.Module, path: Path) -> None:
    """Write a network for images of any size. Raises `RigError` if the file disagrees with the network."""
    side = 6 * MULTIPLE_PX
    planes = torch.randn(1, 3, side, side, generator=torch.Generator().manual_seed(0))
    network = network.eval().to(memory_format=torch.contiguous_format)
    rows, columns = (torch.export.Dim(name, min=1, max=64) for name in ("rows", "columns"))
    sides = {2: MULTIPLE_PX * rows, 3: MULTIPLE_PX * columns}
    model = onnx_model(network, {"difference": planes}, ["logits"], (sides,))
    onnx.save(model, path)
    with torch.inference_mode():
        own = torch.sigmoid(network(planes))[0, 0].numpy()
    share = load_turning(path).share(planes[0].numpy().transpose(1, 2, 0))
    check_agreement(path, share - own, _MOST_DIFFERENCE)


def _double(planes: torch.Tensor) -> torch.Tensor:
    return functional.interpolate(planes, scale_factor=2.0, mode="nearest")


def _batch(
    examples: TurningExamples, at: np.ndarray, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    planes = torch.from_numpy(examples.differences[at]).to(device).float()
    shares, weights = (
        torch.from_numpy(a[at])[:, None].to(device).float() for a in (examples.shares, examples.weights)
    )
    return planes, shares, weights


def _augment(
    planes: torch.Tensor, shares: torch.Tensor, weights: torch.Tensor, generator: torch.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Change pose, colours, light and sharpness of images at random, and add noise."""
    drawn = partial(torch.rand, generator=generator, device=planes.device)
    normal = partial(torch.randn, generator=generator, device=planes.device)
    count = len(planes)
    if drawn(1) < 0.5:
        planes, shares, weights = (a.transpose(2, 3) for a in (planes, shares, weights))
    turns = drawn(count) * 2.0 * math.pi * (drawn(count) < _TURNED)
    scales = torch.exp((drawn(count) * 2.0 - 1.0) * _SCALED)
    mirrored = torch.sign(drawn(count) - 0.5)
    planes, shares, weights = (_move(a, turns, scales, mirrored) for a in (planes, shares, weights))
    mixed = torch.eye(3, device=planes.device) + _MIXED * normal(count, 3, 3)
    order = torch.randperm(3, generator=generator, device=planes.device)
    mixed = mixed[:, order] * torch.sign(drawn(count, 3, 1) - _NEGATIVE)
    strength = torch.exp(_FAINTEST + (_STRONGEST - _FAINTEST) * drawn(count, 1, 1))
    planes = torch.einsum("bij,bjhw->bihw", mixed * strength, planes)
    light = functional.interpolate(
        _UNEVEN * normal(count, 3, 3, 4), size=planes.shape[2:], mode="bilinear", align_corners=True
    )
    planes = planes * torch.exp(light)
    softened = drawn(count, 1, 1, 1) < _SOFTENED
    planes = torch.where(softened, functional.avg_pool2d(planes, 3, 1, 1), planes)
    noise = normal(*planes.shape) * _NOISE * drawn(count, 1, 1, 1)
    planes = _pad(planes + noise).contiguous(memory_format=torch.channels_last)
    below, beside = (f // SHARE_PX - s for f, s in zip(planes.shape[2:], shares.shape[2:], strict=True))
    shares, weights = (functional.pad(a, (0, beside, 0, below)) for a in (shares, weights))
    return planes, shares, weights


def _move(
    planes: torch.Tensor, turns_rad: torch.Tensor, scales: torch.Tensor, mirrored: torch.Tensor
) -> torch.Tensor:
    """Rotate, scale and mirror each image. mirrored: 1 or -1 for each."""
    height, width = planes.shape[2:]
    cos, sin, zero = scales * torch.cos(turns_rad), scales * torch.sin(turns_rad), torch.zeros_like(scales)
    rows = ((mirrored * cos, -sin * height / width, zero), (mirrored * sin * width / height, cos, zero))
    places = torch.stack([torch.stack(row, 1) for row in rows], 1)
    grid = functional.affine_grid(places, list(planes.shape), align_corners=False)
    return functional.grid_sample(planes, grid, padding_mode="border", align_corners=False)


def _pad(planes: torch.Tensor) -> torch.Tensor:
    below, beside = (-side % MULTIPLE_PX for side in planes.shape[2:])
    return functional.pad(planes, (0, beside, 0, below))
