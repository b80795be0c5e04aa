"""`rig train`: data, folds, training, scores, export and cards, one network after another."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from drivers.errors import InputError
from fakes.studio.training_frames import RANDOM_SHAPE
from rig.labels.datasets import Fold, check_objects
from rig.sessions.files import read_json, write_json
from rig.tactile.contact.network import Recipe
from rig.training.cards import model_card, table_row
from rig.training.examples import (
    Examples,
    folder_examples,
    joined,
    load_examples,
    save_examples,
    simulated_examples,
)
from rig.training.export import CARD, HALF, MODEL, Report, export_eight_bit, export_half, export_onnx
from rig.training.loop import Epoch, Training
from rig.training.networks import Architecture
from rig.training.settings import FAMILY, SIMULATED, TrainSettings

CHECKPOINT = "checkpoint.pt"
TABLE = "table2.json"
"""Results of all networks, in the form of `rig/models/table2.json`."""
VALIDATION_SHARE = 0.2
RANDOM_SHARE = 0.5


def train_all(folder: Path, settings: TrainSettings, resume: bool, report: Report) -> list[dict[str, Any]]:
    """Train each network on each fold; return the cards.

    Each finished network is on disk in `folder/<network>_<fold>`. With `resume` it is not trained again, and
    an unfinished training continues after its last epoch. Raises `InputError`.
    """
    _claim(folder, settings, resume)
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    cards = []
    for fold in settings.folds:
        data: tuple[Examples, Examples, Examples] | None = None
        for architecture in settings.architectures:
            place = folder / f"{architecture.name}_{fold.name}"
            if not (place / CARD).exists():
                data = data or fold_examples(folder, settings, fold, report)
                train_one(place, settings, architecture, fold, data, report)
            cards.append(read_json(place / CARD))
    everything = [read_json(path) for path in sorted(folder.glob(f"*/{CARD}"))]
    write_json(folder / TABLE, {"models": [table_row(card) for card in everything]})
    return cards


def train_one(
    folder: Path,
    settings: TrainSettings,
    architecture: Architecture,
    fold: Fold,
    data: tuple[Examples, Examples, Examples],
    report: Report,
) -> None:
    """Train, score and export one network, and write its card."""
    folder.mkdir(parents=True, exist_ok=True)
    train, validation, _ = data
    title = f"{architecture.name} {fold.name}"
    training = Training(
        architecture,
        settings.encoder,
        settings.size(architecture),
        settings.schedule(architecture),
        settings.seed,
    )
    if settings.encoder_weights is not None:
        training.load_encoder(settings.encoder_weights)
    if (folder / CHECKPOINT).exists():
        training.load(folder / CHECKPOINT)

    def show(epoch: Epoch | None, share: float) -> None:
        done = (len(training.history) + (share if epoch is None else 0.0)) / settings.epochs
        text = (
            "" if epoch is None else f", loss {epoch.loss:.4f}, validation Dice {epoch.validation_dice:.4f}"
        )
        report(f"{title}: epoch {max(1, len(training.history))} of {settings.epochs}{text}", done)

    training.run(train, validation, folder / CHECKPOINT, show)
    report(f"{title}: exporting", 1.0)
    recipe = Recipe(architecture.inputs, architecture.threshold, convex=True)
    files = _exported(folder, training, recipe, train)
    write_json(folder / CARD, model_card(settings, fold, data, training, files))


def fold_examples(
    folder: Path, settings: TrainSettings, fold: Fold, report: Report
) -> tuple[Examples, Examples, Examples]:
    """Return the frames to train on, to validate and to test with, of one fold."""
    kept = folder / f"frames_{fold.name}.npz"
    if kept.exists():
        everything = load_examples(kept)
    else:
        everything = _made(settings, fold, report)
        save_examples(kept, everything)
    check_objects(fold, everything.objects, settings.data)
    train = everything.of((*fold.train, RANDOM_SHAPE))
    return train, everything.of(fold.validation), everything.of(fold.test)


def _made(settings: TrainSettings, fold: Fold, report: Report) -> Examples:
    if settings.data != SIMULATED:
        return folder_examples(
            Path(settings.data),
            settings.frame_size,
            lambda done, total: report("reading images", done / total),
        )
    few = max(24, round(VALIDATION_SHARE * settings.images))
    parts = []
    for number, (objects, count, share) in enumerate(
        ((fold.train, settings.images, RANDOM_SHARE), (fold.validation, few, 0.0), (fold.test, few, 0.0))
    ):
        seed = int(np.random.SeedSequence((settings.seed, number, *fold.name.encode())).generate_state(1)[0])
        parts.append(
            simulated_examples(
                objects,
                count,
                seed,
                settings.frame_size,
                share,
                family=settings.units == FAMILY,
                look=settings.look,
                progress=lambda done, count=count: report(f"rendering frames of {fold.name}", done / count),
            )
        )
    return joined(parts)


def _exported(folder: Path, training: Training, recipe: Recipe, train: Examples) -> dict[str, Path]:
    """Write the network in three precisions; return the files by precision."""
    full, half, eight = (folder / name for name in (MODEL, HALF, "model.int8.onnx"))
    export_onnx(training.best_network(), recipe.inputs.channels, training.size, recipe, full)
    export_half(full, half)
    export_eight_bit(full, train, recipe, training.size, eight)
    return {"fp32": full, "fp16": half, "int8": eight}


def _claim(folder: Path, settings: TrainSettings, resume: bool) -> None:
    """Make the folder, or check that it holds the same request. Raises `InputError`."""
    asked = {
        key: getattr(settings, key)
        for key in ("data", "units", "encoder", "images", "epochs", "paper", "seed")
    }
    manifest = folder / "training.json"
    if not manifest.exists():
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder} is not empty and holds no training: give another --out")
        folder.mkdir(parents=True, exist_ok=True)
        write_json(manifest, asked)
        return
    if not resume:
        raise InputError(
            f"{folder} already holds a training: add --resume to continue it, or give another --out"
        )
    kept = read_json(manifest)
    different = [key for key in asked if kept.get(key) != asked[key]]
    if different:
        raise InputError(
            f"{folder} was started with another {', '.join(different)}: continue with the same options, "
            "or give another --out"
        )
