"""Model cards: architecture, training data and scores of a trained network."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from rig.labels.datasets import Fold
from rig.labels.polygons import agreement
from rig.tactile.contact.network import Network, load_network
from rig.tactile.contact.segmenter import Segmenter
from rig.training.examples import Examples
from rig.training.export import file_facts
from rig.training.loop import Training
from rig.training.settings import SIMULATED, TrainSettings

LABEL = "convex hull of each connected part of the contact, gaps up to 17 % of the image's width closed"
EIGHT_BIT_LOSS = 0.005
"""Largest loss of mean Dice at which 8-bit precision counts as equal to full precision."""


@dataclass(frozen=True, slots=True)
class MaskScore:
    """Mean and standard deviation of Dice and IoU over frames; median wall time, frame in to mask out, ms."""

    dice: float
    dice_std: float
    iou: float
    iou_std: float
    ms: float


def score(network: Network, examples: Examples) -> MaskScore:
    """Segment every frame as `rig segment` does and compare it with its label."""
    dice, iou, cost_s = [], [], []
    for frame, background, label in zip(examples.frames, examples.backgrounds, examples.labels, strict=True):
        segmenter = Segmenter(network, background)
        began = perf_counter()
        mask = segmenter.find(frame).mask
        cost_s.append(perf_counter() - began)
        found = agreement(mask, np.where(label > 127, 255, 0).astype(np.uint8))
        dice.append(found.dice)
        iou.append(found.iou)
    return MaskScore(
        float(np.mean(dice)),
        float(np.std(dice)),
        float(np.mean(iou)),
        float(np.std(iou)),
        1e3 * float(np.median(cost_s)),
    )


def model_card(
    settings: TrainSettings,
    fold: Fold,
    data: tuple[Examples, Examples, Examples],
    training: Training,
    files: dict[str, Path],
) -> dict[str, object]:
    """Return the card of a trained network, scored on the fold's test objects.

    data: frames to train on, to validate and to test with. files: ONNX files by precision, fp32 among them.
    """
    architecture, test = training.architecture, data[2]
    scores = {precision: score(load_network(path), test) for precision, path in files.items()}
    full = asdict(scores["fp32"])
    full_ms = full.pop("ms")
    height, width = training.size
    weights = settings.encoder_weights.name if settings.encoder_weights else "random"
    return {
        "name": architecture.name,
        "title": architecture.title,
        "encoder": settings.encoder if architecture.family else None,
        "encoder_weights": weights if architecture.family else None,
        "parameters": sum(p.numel() for p in training.network.parameters()),
        "inputs": architecture.inputs.value,
        "size_px": [width, height],
        "threshold": architecture.threshold,
        "label": LABEL,
        "data": settings.data,
        "simulated": test.simulated,
        "units": settings.units if settings.data == SIMULATED else None,
        "settings": "paper" if settings.paper else "reduced",
        "images": {"train": len(data[0]), "validation": len(data[1]), "test": len(data[2])},
        "fold": asdict(fold),
        "seed": settings.seed,
        "schedule": asdict(training.schedule),
        "epochs": [asdict(epoch) for epoch in training.history],
        "training": {
            "arithmetic": str(training.arithmetic).removeprefix("torch."),
            "threads": torch.get_num_threads(),
            "wall_s": sum(epoch.wall_s for epoch in training.history),
            "cpu_s": sum(epoch.cpu_s for epoch in training.history),
        },
        "test": full,
        "ms_per_frame": full_ms,
        "files": {
            precision: {
                **file_facts(files[precision]),
                "dice": found.dice,
                "ms_per_frame": found.ms,
                "holds": abs(found.dice - full["dice"]) <= EIGHT_BIT_LOSS,
            }
            for precision, found in scores.items()
        },
        "torch": str(torch.__version__),
    }


def table_row(card: Mapping[str, Any]) -> dict[str, object]:
    """Return a card's row in the table of networks and folds."""
    kept = (
        "title", "ms_per_frame", "settings", "size_px", "data", "units", "seed", "images", "training",
    )  # fmt: skip
    row = {"fold": card["fold"]["name"], "epochs": len(card["epochs"]), **card["test"]}
    return row | {key: card[key] for key in kept}
