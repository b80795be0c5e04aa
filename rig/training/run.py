"""What `rig train` does: data, folds, the loop, scores, export and cards, one network after another."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from drivers.errors import InputError
from fakes.studio.training_frames import RANDOM_SHAPE
from rig.labels.folds import Fold, check_objects
from rig.sessions.files import read_json, write_json
from rig.tactile.contact.network import Recipe
from rig.training.cards import model_card, table_row
from rig.training.examples import Examples, joined, load_examples, save_examples
from rig.training.export import ExportedFile, export_eight_bit, export_half, export_onnx
from rig.training.folders import folder_examples
from rig.training.loop import Epoch, Training
from rig.training.networks import Architecture
from rig.training.output import CARD, Tell
from rig.training.settings import FAMILY, SIMULATED, TrainSettings
from rig.training.simulated import simulated_examples

CHECKPOINT = "checkpoint.pt"
TABLE = "table2.json"
"""Results of all networks, in the form that `rig/models/table2.json` keeps them."""
VALIDATION_SHARE = 0.2
RANDOM_SHARE = 0.5


def train_all(folder: Path, settings: TrainSettings, resume: bool, tell: Tell) -> list[dict[str, Any]]:
    """Train each network on each fold; return the cards.

    What is finished is on disk in `folder/<network>_<fold>`; with `resume` it is not done again, and an
    unfinished training goes on after its last epoch. Raises `InputError`.
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
                data = data or fold_examples(folder, settings, fold, tell)
                train_one(place, settings, architecture, fold, data, tell)
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
    tell: Tell,
) -> dict[str, object]:
    """Train, score and export one network; return its card."""
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
        tell(f"{title}: epoch {max(1, len(training.history))} of {settings.epochs}{text}", done)

    training.run(train, validation, folder / CHECKPOINT, show)
    tell(f"{title}: exporting", 1.0)
    recipe = Recipe(architecture.inputs, architecture.threshold, convex=True)
    files = list(_exported(folder, training, recipe, train))
    card = model_card(settings, fold, data, training, files)
    write_json(folder / CARD, card)
    return card


def fold_examples(
    folder: Path, settings: TrainSettings, fold: Fold, tell: Tell
) -> tuple[Examples, Examples, Examples]:
    """Return the frames to train on, to validate and to test with, of one fold."""
    kept = folder / f"frames_{fold.name}.npz"
    if kept.exists():
        everything = load_examples(kept)
    else:
        everything = _made(settings, fold, tell)
        save_examples(kept, everything)
    check_objects(fold, everything.objects, settings.data)
    train = everything.of((*fold.train, RANDOM_SHAPE))
    return train, everything.of(fold.validation), everything.of(fold.test)


def _made(settings: TrainSettings, fold: Fold, tell: Tell) -> Examples:
    if settings.data != SIMULATED:
        return folder_examples(
            Path(settings.data),
            settings.frame_size,
            lambda done, total: tell("reading images", done / total),
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
                progress=lambda done, count=count: tell(f"rendering frames of {fold.name}", done / count),
            )
        )
    return joined(parts)


def _exported(folder: Path, training: Training, recipe: Recipe, train: Examples) -> Iterator[ExportedFile]:
    """Write the network in three precisions."""
    full, half, eight = (folder / name for name in ("model.onnx", "model.half.onnx", "model.int8.onnx"))
    export_onnx(training.best_network(), recipe.inputs.channels, training.size, recipe, full)
    yield ExportedFile("fp32", full)
    export_half(full, half)
    yield ExportedFile("fp16", half)
    export_eight_bit(full, train, recipe, training.size, eight)
    yield ExportedFile("int8", eight)


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
