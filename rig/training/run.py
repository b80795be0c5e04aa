"""What `rig train` does: data, folds, the loop, scores, export and cards, one network after another."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from drivers.errors import InputError
from rig.labels.folds import Fold, check_objects
from rig.records.files import read_json, write_json
from rig.tactile.network import Recipe, load_network
from rig.training.examples import Examples, joined, load_examples, save_examples
from rig.training.export import ExportedFile, export_eight_bit, export_half, export_onnx
from rig.training.folders import folder_examples
from rig.training.loop import Epoch, Schedule, Training
from rig.training.networks import OURS, Architecture
from rig.training.scoring import Score, score
from rig.training.simulated import RANDOM_SHAPE, simulated_examples

SIMULATED = "simulated"
LABEL = "convex hull of each connected part of the contact, gaps up to 17 % of the image's width closed"
CARD, CHECKPOINT = "card.json", "checkpoint.pt"
VALIDATION_SHARE = 0.2
RANDOM_SHARE = 0.5
EIGHT_BIT_LOSS = 0.005
"""An eight-bit file is kept where its mean Dice is within this of the full one's."""


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """What a training is asked for.

    data: a folder, or `SIMULATED`. images: simulated frames to train on, a fold. paper: the paper's
    settings (256 x 320 px, 30 epochs, batch 32) instead of the reduced ones. encoder_weights: a file.
    threads: of torch, None for its own choice.
    """

    data: str
    architectures: tuple[Architecture, ...]
    folds: tuple[Fold, ...]
    encoder: str
    images: int
    epochs: int
    paper: bool
    seed: int
    encoder_weights: Path | None = None
    threads: int | None = None

    def size(self, architecture: Architecture) -> tuple[int, int]:
        """(height, width) in px at which a network looks."""
        return architecture.paper_size if self.paper else architecture.size

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) in px at which frames are kept."""
        return (256, 320) if self.paper else (128, 160)

    def schedule(self, architecture: Architecture) -> Schedule:
        """The paper's batch and rate for its networks; a one-cycle rate for ours."""
        if architecture.name == OURS:
            return Schedule(self.epochs, 32, 4e-3, True)
        return Schedule(self.epochs, 32, 1e-4, False) if self.paper else Schedule(self.epochs, 16, 1e-3, True)


@dataclass(frozen=True, slots=True)
class Progress:
    """Who is told how far a training is: a text, and the share done."""

    tell: Callable[[str, float], None] = lambda text, share: None


def train_all(
    folder: Path, settings: TrainSettings, resume: bool, progress: Progress
) -> list[dict[str, Any]]:
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
                data = data or fold_examples(folder, settings, fold, progress)
                train_one(place, settings, architecture, fold, data, progress)
            cards.append(read_json(place / CARD))
    write_json(folder / "results.json", {"models": cards})
    return cards


def train_one(
    folder: Path,
    settings: TrainSettings,
    architecture: Architecture,
    fold: Fold,
    data: tuple[Examples, Examples, Examples],
    progress: Progress,
) -> dict[str, Any]:
    """Train, score and export one network; return its card."""
    folder.mkdir(parents=True, exist_ok=True)
    train, validation, test = data
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
        progress.tell(f"{title}: epoch {max(1, len(training.history))} of {settings.epochs}{text}", done)

    training.run(train, validation, folder / CHECKPOINT, show)
    progress.tell(f"{title}: exporting", 1.0)
    recipe = Recipe(architecture.inputs, architecture.threshold, convex=True)
    files = list(_exported(folder, training, recipe, train))
    card = _card(settings, architecture, fold, data, training, files, test)
    write_json(folder / CARD, card)
    return card


def fold_examples(
    folder: Path, settings: TrainSettings, fold: Fold, progress: Progress
) -> tuple[Examples, Examples, Examples]:
    """Return the frames to train on, to validate and to test with, of one fold."""
    kept = folder / f"frames_{fold.name}.npz"
    if kept.exists():
        everything = load_examples(kept)
    else:
        everything = _made(settings, fold, progress)
        save_examples(kept, everything)
    check_objects(fold, everything.objects, settings.data)
    train = everything.of((*fold.train, RANDOM_SHAPE))
    return train, everything.of(fold.validation), everything.of(fold.test)


def _made(settings: TrainSettings, fold: Fold, progress: Progress) -> Examples:
    if settings.data != SIMULATED:
        return folder_examples(
            Path(settings.data),
            settings.frame_size,
            lambda done, total: progress.tell("reading images", done / total),
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
                progress=lambda done, count=count: progress.tell(
                    f"rendering frames of {fold.name}", done / count
                ),
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


def _card(
    settings: TrainSettings,
    architecture: Architecture,
    fold: Fold,
    data: tuple[Examples, Examples, Examples],
    training: Training,
    files: list[ExportedFile],
    test: Examples,
) -> dict[str, Any]:
    scores: dict[str, Score] = {file.precision: score(load_network(file.path), test) for file in files}
    full = scores["fp32"]
    height, width = training.size
    return {
        "name": architecture.name,
        "title": architecture.title,
        "encoder": settings.encoder if architecture.family else None,
        "parameters": sum(p.numel() for p in training.network.parameters()),
        "inputs": architecture.inputs.value,
        "size_px": [width, height],
        "threshold": architecture.threshold,
        "label": LABEL,
        "data": settings.data,
        "simulated": settings.data == SIMULATED,
        "settings": "paper" if settings.paper else "reduced",
        "images": {"train": len(data[0]), "validation": len(data[1]), "test": len(data[2])},
        "fold": {"name": fold.name, "train": fold.train, "validation": fold.validation, "test": fold.test},
        "seed": settings.seed,
        "schedule": asdict(training.schedule),
        "epochs": [{"loss": e.loss, "validation_dice": e.validation_dice} for e in training.history],
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


def _claim(folder: Path, settings: TrainSettings, resume: bool) -> None:
    """Make the folder, or check that it holds the same request. Raises `InputError`."""
    asked = {
        "data": settings.data,
        "encoder": settings.encoder,
        "images": settings.images,
        "epochs": settings.epochs,
        "paper": settings.paper,
        "seed": settings.seed,
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
