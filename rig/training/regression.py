"""Fitting a network: Adam, a one-cycle rate, the best epoch kept."""

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

LARGEST_GRADIENT = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """epochs, batch, and peak rate of a one-cycle schedule (Smith 2018)."""

    epochs: int
    batch: int
    rate: float


Tell = Callable[[int, float, float], None]
"""Is told epoch, mean loss, and mean absolute error on validation, in the unit of its answer."""


def fit(
    network: nn.Module,
    plan: Plan,
    examples: int,
    loss: Callable[[torch.Tensor], torch.Tensor],
    error: Callable[[], float],
    tell: Tell,
) -> list[float]:
    """Fit in place and leave the network with the weights of its best epoch; return the epochs' errors.

    examples: how many there are. loss: of those at some places. error: on the validation lifts,
    with the network as it then is.
    """
    steps = -(-examples // plan.batch)
    optimizer = torch.optim.AdamW(network.parameters(), lr=plan.rate, weight_decay=0.01)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimizer, plan.rate, total_steps=plan.epochs * steps)
    best, errors = deepcopy(network.state_dict()), []
    for epoch in range(1, plan.epochs + 1):
        network.train()
        losses = [_step(network, optimizer, cycle, loss(at)) for at in _batches(examples, plan.batch)]
        network.eval()
        errors.append(error())
        if errors[-1] <= min(errors):
            best = deepcopy(network.state_dict())
        tell(epoch, float(np.mean(losses)), errors[-1])
    network.load_state_dict(best)
    return errors


def _batches(examples: int, batch: int) -> Iterable[torch.Tensor]:
    return torch.randperm(examples).split(batch)


def _step(
    network: nn.Module,
    optimizer: torch.optim.Optimizer,
    cycle: torch.optim.lr_scheduler.LRScheduler,
    loss: torch.Tensor,
) -> float:
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
    optimizer.step()
    cycle.step()
    return loss.item()
