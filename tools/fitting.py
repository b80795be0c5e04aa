"""Code that both trainings use: the output folder, and the loop that fits a network.

To train a network, run `python tools/train_angle.py --help` or `python tools/train_turning.py --help`.
"""

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import numpy as np
import torch
from torch import nn

from drivers.errors import InputError
from rig.training.loop import Report

LARGEST_GRADIENT = 1.0
"""Limit of the norm of the gradient in a step."""


def claim_folder(out: Path, threads: int | None) -> None:
    """Make an empty output folder and set torch's number of threads, None for its default.

    Raises `InputError` if the folder is not empty or cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        taken = any(out.iterdir())
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}): give another --out") from error
    if taken:
        raise InputError(f"{out} is not empty: give another --out")
    if threads is not None:
        torch.set_num_threads(threads)


def fit(
    network: nn.Module,
    epochs: int,
    batch: int,
    rate: float,
    examples: int,
    loss: Callable[[torch.Tensor], torch.Tensor],
    error: Callable[[], float],
    report: Report,
    shown: str,
) -> list[float]:
    """Fit in place, restore the weights of the best epoch, and return the error of each epoch.

    rate: peak of the one-cycle schedule (Smith 2018). examples: their number. loss: of the examples at some
    indices. error: on the validation lifts, with the current weights. shown: the text that is reported after
    an epoch, with places for `epoch`, its mean `loss`, and `error`.
    """
    steps = -(-examples // batch)
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=0.01)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * steps)
    best, errors = deepcopy(network.state_dict()), []
    for epoch in range(1, epochs + 1):
        network.train()
        losses = []
        for at in torch.randperm(examples).split(batch):
            of_batch = loss(at)
            optimizer.zero_grad()
            of_batch.backward()
            nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
            optimizer.step()
            cycle.step()
            losses.append(of_batch.item())
        network.eval()
        errors.append(error())
        if errors[-1] <= min(errors):
            best = deepcopy(network.state_dict())
        text = shown.format(epoch=f"epoch {epoch} of {epochs}", loss=float(np.mean(losses)), error=errors[-1])
        report(text, epoch / epochs)
    network.load_state_dict(best)
    return errors
