"""The peers' networks as ONNX files, checked against the networks they came from."""

from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from drivers.errors import RigError
from rig.tactile.peers.networks import load_image_network, load_wrench_network
from rig.training.angle_net import SIZE, AngleNet
from rig.training.export import export_half, onnx_model
from rig.training.wrist import HIDDEN, WrenchNetwork

MOST_DIFFERENCE_DEG = 0.01
MOST_DIFFERENCE_HALF_DEG = 0.2
"""Of an angle by a file from the network's own: in full, and with weights kept in half precision."""
_STEPS = 20


class WrenchStep(nn.Module):
    """One step of a `WrenchNetwork`: wrench (1, 1, 6) and memory (1, 1, H) to angle (1, 1) and memory."""

    def __init__(self, network: WrenchNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the angle in degrees, and the memory after."""
        unit, before = self.network.unit, memory[0]
        felt = (wrench / self.network.scale)[0] @ unit.weight_ih_l0.T + unit.bias_ih_l0
        kept = before @ unit.weight_hh_l0.T + unit.bias_hh_l0
        # gates in torch's order: reset, update, new (Cho et al. 2014)
        (reset, update, new), (reset_kept, update_kept, new_kept) = felt.chunk(3, -1), kept.chunk(3, -1)
        fresh = torch.tanh(new + torch.sigmoid(reset + reset_kept) * new_kept)
        share = torch.sigmoid(update + update_kept)
        after = (1.0 - share) * fresh + share * before
        return self.network.angle_deg(after), after[None]


def export_wrist(network: WrenchNetwork, path: Path) -> None:
    """Write a network as one step. Raises `RigError` where the file answers otherwise than the network."""
    inputs = {"wrench": torch.zeros(1, 1, 6), "memory": torch.zeros(1, 1, HIDDEN)}
    onnx.save(onnx_model(WrenchStep(network), inputs, ["angle_deg", "memory_after"]), path)
    wrench = torch.randn(1, _STEPS, 6, generator=torch.Generator().manual_seed(0)) * network.scale
    with torch.inference_mode():
        own = network(wrench, inputs["memory"])[0][0].numpy()
    loaded = load_wrench_network(path)
    memory, told = loaded.blank(), []
    for step in wrench[0].numpy():
        angle, memory = loaded.step(step, memory)
        told.append(angle)
    _agreed(path, np.array(told) - own, MOST_DIFFERENCE_DEG)


def export_angle_net(network: AngleNet, full: Path, half: Path) -> None:
    """Write a network in full, and with weights in half precision. Raises `RigError` where they disagree."""
    width, height = SIZE
    frame = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0))
    onnx.save(onnx_model(network, {"frame": frame}, ["angle_deg"]), full)
    export_half(full, half)
    image = (frame[0].numpy().transpose(1, 2, 0) * 255.0).astype(np.uint8)
    seen = torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32) / 255.0)
    with torch.inference_mode():
        own = network(seen).numpy()
    for path, most in ((full, MOST_DIFFERENCE_DEG), (half, MOST_DIFFERENCE_HALF_DEG)):
        _agreed(path, load_image_network(path).angle_deg(image) - own, most)


def _agreed(path: Path, differences_deg: np.ndarray, most_deg: float) -> None:
    worst = float(np.abs(differences_deg).max())
    if not worst <= most_deg:
        raise RigError(f"{path}: differs from its network by {worst:.2g} deg, more than {most_deg:g}")
