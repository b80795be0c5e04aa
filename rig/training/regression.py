"""Fit a network with AdamW and a one-cycle rate; keep the best epoch."""

from collections.abc import Callable
from copy import deepcopy

import numpy as np
import torch
from torch import nn

LARGEST_GRADIENT = 1.0


EpochReport = Callable[[int, float, float], None]
"""Takes the epoch, its mean loss, and the mean absolute validation error in the unit of the output."""


def fit(
    network: nn.Module,
    epochs: int,
    batch: int,
    rate: float,
    examples: int,
    loss: Callable[[torch.Tensor], torch.Tensor],
    error: Callable[[], float],
    report: EpochReport,
) -> list[float]:
    """Fit in place, restore the weights of the best epoch, and return the error of each epoch.

    rate: peak of the one-cycle schedule (Smith 2018). examples: their number. loss: of the examples at some
    indices. error: on the validation lifts, with the current weights.
    """
    steps = -(-examples // batch)
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=0.01)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * steps)
    best, errors = deepcopy(network.state_dict()), []
    for epoch in range(1, epochs + 1):
        network.train()
        losses = [_step(network, optimizer, cycle, loss(at)) for at in torch.randperm(examples).split(batch)]
        network.eval()
        errors.append(error())
        if errors[-1] <= min(errors):
            best = deepcopy(network.state_dict())
        report(epoch, float(np.mean(losses)), errors[-1])
    network.load_state_dict(best)
    return errors


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
