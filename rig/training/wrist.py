"""A recurrent network from the wrench at the wrist to the pivoting angle, after Toskov et al. 2022.

One gated recurrent unit and a linear layer, trained on whole lifts and exported as one step with
its memory as input and output.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from rig.tactile.peers.wrench_steps import WrenchSteps
from rig.training.lifts import WristSeries
from rig.training.regression import Plan, Tell, fit

HIDDEN = 32
BATCH, RATE = 64, 4e-3
AT_REST = 0.1
"""Weight of steps before the lift, whose angle is 0."""
_FORCE_N, _TORQUE_NM, _ANGLE_DEG = 0.3, 0.01, 10.0
"""What is about 1 inside the network."""
_MIRRORED = (-1.0, 1.0, 1.0, 1.0, -1.0, -1.0)
"""A wrench seen in a mirror across the hand: a force's x turns over, and of a torque y and z."""


class WrenchNetwork(nn.Module):
    """Wrenches (N, T, 6), N and N m, and memory (1, N, H) to angles (N, T) in degrees and memory after."""

    def __init__(self, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.unit = nn.GRU(6, hidden, batch_first=True)
        self.head = nn.Linear(hidden, 1)
        self.register_buffer("scale", torch.tensor([_FORCE_N] * 3 + [_TORQUE_NM] * 3))

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return angles and the memory after."""
        felt, memory = self.unit(wrench / self.scale, memory)
        return self.angle_deg(felt), memory

    def angle_deg(self, felt: torch.Tensor) -> torch.Tensor:
        """Return the angles that go with memories (..., H)."""
        return _ANGLE_DEG * self.head(felt)[..., 0]


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """Lifts as steps. wrench: (N, T, 6); angle: (N, T) deg; weight: (N, T), 0 beyond a lift's end."""

    wrench: torch.Tensor
    angle: torch.Tensor
    weight: torch.Tensor


def sequences(lifts: Sequence[WristSeries]) -> Sequences:
    """Return lifts in even steps, filled up to the longest."""
    steps = [_steps(lift) for lift in lifts]
    longest = max(len(weights) for *_, weights in steps)
    wrench, angle, weight = (np.zeros((len(steps), longest, *extra), np.float32) for extra in ((6,), (), ()))
    for row, (wrenches, angles, weights) in enumerate(steps):
        wrench[row, : len(weights)] = wrenches
        angle[row, : len(weights)] = angles
        weight[row, : len(weights)] = weights
    return Sequences(*map(torch.from_numpy, (wrench, angle, weight)))


def train_wrist(
    train: Sequences, validation: Sequences, epochs: int, seed: int, tell: Tell
) -> tuple[WrenchNetwork, list[float]]:
    """Train; return the network of the epoch best on the validation lifts, and each epoch's error there.

    Half of the lifts, drawn anew each time, are seen in a mirror.
    """
    torch.manual_seed(seed)
    network, mirrored = WrenchNetwork(), torch.tensor(_MIRRORED)

    def loss(at: torch.Tensor) -> torch.Tensor:
        side = torch.where(torch.rand(len(at), 1) < 0.5, 1.0, -1.0)
        wrench = train.wrench[at] * torch.where(side[..., None] < 0.0, mirrored, torch.ones(6))
        found, _ = network(wrench, _blank(len(at)))
        weight = train.weight[at]
        return (weight * (found - side * train.angle[at]).abs()).sum() / weight.sum()

    plan = Plan(epochs, BATCH, RATE)
    errors = fit(network, plan, len(train.wrench), loss, lambda: error_deg(network, validation), tell)
    return network, errors


def error_deg(network: WrenchNetwork, lifts: Sequences) -> float:
    """Return the mean absolute error over phases B and C."""
    with torch.inference_mode():
        found, _ = network(lifts.wrench, _blank(len(lifts.wrench)))
    rising = lifts.weight > AT_REST
    return float((found - lifts.angle).abs()[rising].mean())


def blind_error_deg(lifts: Sequences) -> float:
    """Return the mean absolute error of saying 0 all the time, over phases B and C."""
    return float(lifts.angle[lifts.weight > AT_REST].abs().mean())


def _blank(count: int) -> torch.Tensor:
    return torch.zeros(1, count, HIDDEN)


def _steps(lift: WristSeries) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return wrenches (T, 6), angles (T,) and weights (T,) of one lift; unknown angles weigh nothing."""
    steps, rows = WrenchSteps(), []
    for state, angle, rising in zip(lift.states, lift.turn_deg, lift.rising, strict=True):
        step = steps.add(state)
        if step is not None:
            known = np.isfinite(angle)
            rows.append((step, angle if known else 0.0, (1.0 if rising else AT_REST) * known))
    wrenches, angles, weights = zip(*rows, strict=True)
    return np.stack(wrenches), np.array(angles), np.array(weights)
