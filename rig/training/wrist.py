"""A recurrent network that estimates the pivoting angle from the wrench at the wrist (Toskov et al. 2022).

It consists of one gated recurrent unit and a linear layer. It is trained on whole lifts and exported as a
single time step, with its memory as input and output.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from rig.tactile.peers.learned import WrenchSteps, load_wrench_network
from rig.training.export import check_agreement, onnx_model
from rig.training.lifts import WristSeries
from rig.training.loop import EpochReport, fit

HIDDEN = 32
BATCH, RATE = 64, 4e-3
AT_REST = 0.1
"""Weight of steps before the lift, whose angle is 0."""
_FORCE_N, _TORQUE_NM, _ANGLE_DEG = 0.3, 0.01, 10.0
"""Scales of the network's inputs and output, which are then about 1."""
_MIRRORED = (-1.0, 1.0, 1.0, 1.0, -1.0, -1.0)
"""Signs of a wrench mirrored across the hand: force x and torque y and z change sign."""
MOST_DIFFERENCE_DEG = 0.01
"""Largest accepted difference between the angles of a network and of its file."""
_STEPS = 20


class WrenchNetwork(nn.Module):
    """Wrenches (N, T, 6), N and N m, and memory (1, N, H) to angles (N, T) in degrees and the new memory."""

    def __init__(self) -> None:
        super().__init__()
        self.unit = nn.GRU(6, HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, 1)
        self.register_buffer("scale", torch.tensor([_FORCE_N] * 3 + [_TORQUE_NM] * 3))

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        felt, memory = self.unit(wrench / self.scale, memory)
        return self.angle_deg(felt), memory

    def angle_deg(self, felt: torch.Tensor) -> torch.Tensor:
        return _ANGLE_DEG * self.head(felt)[..., 0]


class WrenchStep(nn.Module):
    """One step of a `WrenchNetwork`: wrench (1, 1, 6) and memory (1, 1, H) to angle (1, 1) and memory."""

    def __init__(self, network: WrenchNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        unit, before = self.network.unit, memory[0]
        felt = (wrench / self.network.scale)[0] @ unit.weight_ih_l0.T + unit.bias_ih_l0
        kept = before @ unit.weight_hh_l0.T + unit.bias_hh_l0
        # gates in torch's order: reset, update, new (Cho et al. 2014)
        (reset, update, new), (reset_kept, update_kept, new_kept) = felt.chunk(3, -1), kept.chunk(3, -1)
        fresh = torch.tanh(new + torch.sigmoid(reset + reset_kept) * new_kept)
        share = torch.sigmoid(update + update_kept)
        after = (1.0 - share) * fresh + share * before
        return self.network.angle_deg(after), after[None]


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """Lifts as steps. wrench: (N, T, 6); angle: (N, T) deg; weight: (N, T), 0 beyond a lift's end."""

    wrench: torch.Tensor
    angle: torch.Tensor
    weight: torch.Tensor


def sequences(lifts: Sequence[WristSeries]) -> Sequences:
    """Return lifts in equal time steps, padded to the longest."""
    steps = [_steps(lift) for lift in lifts]
    longest = max(len(weights) for *_, weights in steps)
    wrench, angle, weight = (np.zeros((len(steps), longest, *extra), np.float32) for extra in ((6,), (), ()))
    for row, (wrenches, angles, weights) in enumerate(steps):
        wrench[row, : len(weights)] = wrenches
        angle[row, : len(weights)] = angles
        weight[row, : len(weights)] = weights
    return Sequences(*map(torch.from_numpy, (wrench, angle, weight)))


def train_wrist(
    train: Sequences, validation: Sequences, epochs: int, seed: int, report: EpochReport
) -> tuple[WrenchNetwork, list[float]]:
    """Train; return the network of the best epoch, and the validation error of each epoch.

    A random half of each batch is mirrored.
    """
    torch.manual_seed(seed)
    network, mirrored = WrenchNetwork(), torch.tensor(_MIRRORED)

    def loss(at: torch.Tensor) -> torch.Tensor:
        side = torch.where(torch.rand(len(at), 1) < 0.5, 1.0, -1.0)
        wrench = train.wrench[at] * torch.where(side[..., None] < 0.0, mirrored, torch.ones(6))
        found, _ = network(wrench, _blank(len(at)))
        weight = train.weight[at]
        return (weight * (found - side * train.angle[at]).abs()).sum() / weight.sum()

    validate = partial(error_deg, network, validation)
    errors = fit(network, epochs, BATCH, RATE, len(train.wrench), loss, validate, report)
    return network, errors


def error_deg(network: WrenchNetwork, lifts: Sequences) -> float:
    """Return the mean absolute error over phases B and C."""
    with torch.inference_mode():
        found, _ = network(lifts.wrench, _blank(len(lifts.wrench)))
    rising = lifts.weight > AT_REST
    return float((found - lifts.angle).abs()[rising].mean())


def blind_error_deg(lifts: Sequences) -> float:
    """Return the mean absolute error of always predicting 0, over phases B and C."""
    return float(lifts.angle[lifts.weight > AT_REST].abs().mean())


def export_wrist(network: WrenchNetwork, path: Path) -> None:
    """Write a network as one time step. Raises `RigError` if the file disagrees with the network."""
    inputs = {"wrench": torch.zeros(1, 1, 6), "memory": torch.zeros(1, 1, HIDDEN)}
    onnx.save(onnx_model(WrenchStep(network), inputs, ["angle_deg", "memory_after"]), path)
    wrench = torch.randn(1, _STEPS, 6, generator=torch.Generator().manual_seed(0)) * network.scale
    with torch.inference_mode():
        own = network(wrench, inputs["memory"])[0][0].numpy()
    loaded = load_wrench_network(path)
    memory, angles_deg = loaded.blank(), []
    for step in wrench[0].numpy():
        angle, memory = loaded.step(step, memory)
        angles_deg.append(angle)
    check_agreement(path, np.array(angles_deg) - own, MOST_DIFFERENCE_DEG, " deg")


def _blank(count: int) -> torch.Tensor:
    return torch.zeros(1, count, HIDDEN)


def _steps(lift: WristSeries) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return wrenches (T, 6), angles (T,) and weights (T,), 0 without ground truth, of one lift."""
    steps, rows = WrenchSteps(), []
    for state, angle, rising in zip(lift.states, lift.turn_deg, lift.rising, strict=True):
        step = steps.add(state)
        if step is not None:
            known = np.isfinite(angle)
            rows.append((step, angle if known else 0.0, (1.0 if rising else AT_REST) * known))
    wrenches, angles, weights = zip(*rows, strict=True)
    return np.stack(wrenches), np.array(angles), np.array(weights)
