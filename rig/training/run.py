"""`rig train`: settings, data, folds, training, scores, export and cards, one network after another."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from calibration.gel.look import GelLook, load_look
from drivers.errors import InputError, unknown_name
from fakes.studio.training_frames import RANDOM_SHAPE
from rig.frames.masks import SegmentChoice, segmenter_maker
from rig.labels.datasets import OWN_FOLD, Fold, check_objects
from rig.sessions.codec import json_value
from rig.sessions.files import read_json, write_json
from rig.tactile.contact.network import NetworkInput, Recipe
from rig.training.examples import (
    Examples,
    concatenate,
    folder_examples,
    load_examples,
    save_examples,
    simulated_examples,
)
from rig.training.export import (
    CARD,
    HALF,
    MODEL,
    export_eight_bit,
    export_half,
    export_onnx,
    file_facts,
)
from rig.training.loop import Epoch, Report, Schedule, Training
from rig.training.networks import OURS, Architecture
from rig.training.scores import score_masks

SIMULATED = "simulated"
"""Value of `data` for frames that are rendered for this training."""
VARIED, FAMILY = "varied", "family"
UNITS = (VARIED, FAMILY)
"""Kinds of simulated sensors. `varied`: many makes; the network generalises to unseen makes. `family`: one
make, as on a bench and in the paper's data set. Instead, the file of a real unit's look can be given: sensors
are then of varied makes, and every second one is a variation of that look."""
LOOK_SUFFIX = ".npz"


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """Settings of a training.

    data: a folder, or `SIMULATED`. images: simulated training frames per fold. paper: the paper's
    parameters (256 x 320 px, 30 epochs, batch 32) instead of the reduced ones. encoder_weights: a file.
    threads: of torch, None for its default. units: the simulated sensors, see `UNITS`.
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
    units: str = VARIED

    @property
    def look(self) -> GelLook | None:
        """The real unit's look whose variations are among the simulated sensors; None without one."""
        return load_look(Path(self.units)) if self.units.endswith(LOOK_SUFFIX) else None

    def size(self, architecture: Architecture) -> tuple[int, int]:
        """(height, width) of a network's input in px."""
        return architecture.paper_size if self.paper else architecture.size

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) of the stored frames in px."""
        return (256, 320) if self.paper else (128, 160)

    def schedule(self, architecture: Architecture) -> Schedule:
        """The paper's batch and rate for its networks; a one-cycle rate for ours."""
        if architecture.name == OURS:
            return Schedule(self.epochs, 32, 4e-3, True)
        return Schedule(self.epochs, 32, 1e-4, False) if self.paper else Schedule(self.epochs, 16, 1e-3, True)


def checked_units(name: str) -> str:
    """Return `name` if it is a kind of units or the file of a look (.npz). Raises `RigError` otherwise."""
    if name.endswith(LOOK_SUFFIX):
        load_look(Path(name))
    elif name not in UNITS:
        raise unknown_name("kind of simulated sensors", name, UNITS)
    return name


LABEL = "convex hull of each connected part of the contact, gaps up to 17 % of the image's width closed"
EIGHT_BIT_LOSS = 0.005
"""Largest loss of mean Dice at which 8-bit precision counts as equal to full precision."""


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
    architecture, test, (height, width) = training.architecture, data[2], training.size
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
        **_scores(files, architecture, test),
        "torch": str(torch.__version__),
    }


def _scores(files: dict[str, Path], architecture: Architecture, test: Examples) -> dict[str, object]:
    """Return the scores of a card.

    Every file is scored alone; "as_used" has the scores of the masks of `rig segment`, which also contain the
    parts of a contact that the network has missed, for networks that compare with a frame without contact.
    """

    def score(file: Path, alone: bool) -> dict[str, float]:
        return asdict(score_masks(segmenter_maker(SegmentChoice(str(file), alone=alone)), test))

    alone = {precision: score(file, True) for precision, file in files.items()}
    full, compares = alone["fp32"], architecture.inputs is NetworkInput.FRAME_AND_DIFFERENCE
    as_used = score(files["fp32"], False) if compares else None
    return {
        "test": _shares(full),
        "as_used": None if as_used is None else _shares(as_used),
        "ms_per_frame": (as_used or full)["ms"],
        "files": {
            precision: {
                **file_facts(files[precision]),
                "dice": found["dice"],
                "ms_per_frame": found["ms"],
                "holds": abs(found["dice"] - full["dice"]) <= EIGHT_BIT_LOSS,
            }
            for precision, found in alone.items()
        },
    }


def _shares(score: Mapping[str, float]) -> dict[str, float]:
    return {name: score[name] for name in ("dice", "dice_std", "iou", "iou_std")}


def table_row(card: Mapping[str, Any]) -> dict[str, object]:
    """Return a card's row in the table of networks and folds."""
    kept = "title as_used ms_per_frame settings size_px data units seed images training".split()
    row = {"fold": card["fold"]["name"], "epochs": len(card["epochs"]), **card["test"]}
    return row | {key: card[key] for key in kept}


CHECKPOINT, MANIFEST = "checkpoint.pt", "training.json"
TABLE = "table2.json"
"""Results of all networks, in the form of `rig/models/table2.json`."""
VALIDATION_SHARE = 0.2
RANDOM_SHARE = 0.5


def train_all(folder: Path, settings: TrainSettings, resume: bool, report: Report) -> list[dict[str, Any]]:
    """Train each network on each fold; return the cards.

    Each finished network is on disk in `folder/<network>_<fold>`. With `resume` it is not trained again, and
    an unfinished training continues after its last epoch. Raises `InputError`.
    """
    check_folder(folder, settings, resume)
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
    schedule, size = settings.schedule(architecture), settings.size(architecture)
    training = Training(architecture, settings.encoder, size, schedule, settings.seed)
    if settings.encoder_weights is not None:
        training.load_encoder(settings.encoder_weights)
    if (folder / CHECKPOINT).exists():
        training.load(folder / CHECKPOINT)

    def show(epoch: Epoch | None, share: float) -> None:
        done = (len(training.history) + (share if epoch is None else 0.0)) / settings.epochs
        text = f", loss {epoch.loss:.4f}, validation Dice {epoch.validation_dice:.4f}" if epoch else ""
        report(f"{title}: epoch {max(1, len(training.history))} of {settings.epochs}{text}", done)

    training.run(train, validation, folder / CHECKPOINT, show)
    report(f"{title}: exporting", 1.0)
    recipe = Recipe(architecture.inputs, architecture.threshold, convex=True)
    files = {"fp32": folder / MODEL, "fp16": folder / HALF, "int8": folder / "model.int8.onnx"}
    export_onnx(training.best_network(), recipe.inputs.channels, size, recipe, files["fp32"])
    export_half(files["fp32"], files["fp16"])
    export_eight_bit(files["fp32"], train, recipe, size, files["int8"])
    write_json(folder / CARD, model_card(settings, fold, data, training, files))


def fold_examples(
    folder: Path, settings: TrainSettings, fold: Fold, report: Report
) -> tuple[Examples, Examples, Examples]:
    """Return the frames to train on, to validate and to test with, of one fold."""
    kept = folder / f"frames_{fold.name}.npz"
    everything = load_examples(kept) if kept.exists() else _make_examples(settings, fold, report)
    check_objects(fold, everything.objects, settings.data)
    if not kept.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / MANIFEST, _request(settings))
        save_examples(kept, everything)
    others = set(everything.objects) - {*fold.validation, *fold.test}
    train = everything.of((*fold.train, RANDOM_SHAPE) if fold.train else tuple(others))
    return train, everything.of(fold.validation), everything.of(fold.test)


def _make_examples(settings: TrainSettings, fold: Fold, report: Report) -> Examples:
    size, few = settings.frame_size, max(24, round(VALIDATION_SHARE * settings.images))
    if settings.data != SIMULATED:
        named = (*fold.validation, *fold.test) if fold.name == OWN_FOLD else ()
        return folder_examples(
            Path(settings.data), size, lambda n, of: report("reading images", n / of), named
        )
    wanted = (fold.train, settings.images, RANDOM_SHARE), (fold.validation, few, 0.0), (fold.test, few, 0.0)
    units, parts = {"family": settings.units == FAMILY, "look": settings.look}, []
    for number, (objects, count, share) in enumerate(wanted):
        seed = int(np.random.SeedSequence((settings.seed, number, *fold.name.encode())).generate_state(1)[0])

        def progress(done: int, count: int = count) -> None:
            report(f"rendering frames of {fold.name}", done / count)

        parts.append(simulated_examples(objects, count, seed, size, share, progress=progress, **units))
    return concatenate(parts)


def _request(settings: TrainSettings) -> dict[str, Any]:
    """Return the settings that all networks in a folder share."""
    keys = ("data", "units", "encoder", "images", "epochs", "paper", "seed")
    own = next((fold for fold in settings.folds if fold.name == OWN_FOLD), None)
    return {key: getattr(settings, key) for key in keys} | {"own": own and json_value(own)}


def check_folder(folder: Path, settings: TrainSettings, resume: bool) -> None:
    """Raise `InputError` unless the folder is empty, or holds the same request and shall be resumed."""
    asked, manifest = _request(settings), folder / MANIFEST
    if not manifest.exists():
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder} is not empty and holds no training: give another --out")
        return
    if not resume:
        raise InputError(
            f"{folder} already holds a training: add --resume to continue it, or give another --out"
        )
    kept = read_json(manifest)
    if different := [key for key in asked if kept.get(key) != asked[key]]:
        raise InputError(
            f"{folder} was started with another {', '.join(different)}: continue with the same options, "
            "or give another --out"
        )
