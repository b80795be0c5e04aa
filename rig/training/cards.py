"""Model cards: what a trained network is, what it was trained on, how well it does."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch

from rig.labels.folds import Fold
from rig.tactile.contact.network import load_network
from rig.training.examples import Examples
from rig.training.export import ExportedFile
from rig.training.loop import Training
from rig.training.networks import Architecture
from rig.training.scoring import MaskScore, score
from rig.training.settings import SIMULATED, TrainSettings

LABEL = "convex hull of each connected part of the contact, gaps up to 17 % of the image's width closed"
EIGHT_BIT_LOSS = 0.005
"""A file of lower precision holds where its mean Dice is within this of the full one's."""


def model_card(
    settings: TrainSettings,
    fold: Fold,
    data: tuple[Examples, Examples, Examples],
    training: Training,
    files: list[ExportedFile],
) -> dict[str, object]:
    """Return the card of a trained network, scored on the fold's test objects.

    data: frames to train on, to validate and to test with.
    """
    architecture, test = training.architecture, data[2]
    scores: dict[str, MaskScore] = {file.precision: score(load_network(file.path), test) for file in files}
    full = scores["fp32"]
    height, width = training.size
    return {
        "name": architecture.name,
        "title": architecture.title,
        "encoder": settings.encoder if architecture.family else None,
        "encoder_weights": _first_weights(settings, architecture),
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
        "fold": {"name": fold.name, "train": fold.train, "validation": fold.validation, "test": fold.test},
        "seed": settings.seed,
        "schedule": asdict(training.schedule),
        "epochs": [asdict(epoch) for epoch in training.history],
        "training": {
            "arithmetic": str(training.arithmetic).removeprefix("torch."),
            "threads": torch.get_num_threads(),
            "wall_s": sum(epoch.wall_s for epoch in training.history),
            "cpu_s": sum(epoch.cpu_s for epoch in training.history),
        },
        "test": {"dice": full.dice, "dice_std": full.dice_std, "iou": full.iou, "iou_std": full.iou_std},
        "ms_per_frame": full.ms,
        "files": {
            file.precision: {
                **file.facts(),
                "dice": scores[file.precision].dice,
                "ms_per_frame": scores[file.precision].ms,
                "holds": abs(scores[file.precision].dice - full.dice) <= EIGHT_BIT_LOSS,
            }
            for file in files
        },
        "torch": str(torch.__version__),
    }


def _first_weights(settings: TrainSettings, architecture: Architecture) -> str | None:
    if architecture.family is None:
        return None
    return settings.encoder_weights.name if settings.encoder_weights else "random"


def table_row(card: Mapping[str, Any]) -> dict[str, object]:
    """Return what a card adds to the table of networks and folds."""
    kept = (
        "title", "ms_per_frame", "settings", "size_px", "data", "units", "seed", "images", "training",
    )  # fmt: skip
    row = {"fold": card["fold"]["name"], "epochs": len(card["epochs"]), **card["test"]}
    return row | {key: card[key] for key in kept}
