"""Training of the networks that tell an angle: data, split by objects, export, card."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from drivers.errors import InputError
from protocols.grasps import TRIAL_OBJECTS, load_grasp_files
from rig.sessions.files import write_json
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.tactile.estimators import ANGLENET, TOSKOV
from rig.training.angle_net import BACKBONE, SIZE, train_angle_net
from rig.training.angle_net import error_deg as views_error_deg
from rig.training.export import ExportedFile
from rig.training.lifts import GelViews, WristSeries, stacked_views, stored_lifts
from rig.training.output import CARD, MODEL, Tell, claim
from rig.training.peer_export import export_angle_net, export_wrist
from rig.training.simulated_lifts import simulated_views, simulated_wrists
from rig.training.wrist import blind_error_deg, error_deg, sequences, train_wrist

HALF = "model.half.onnx"
VALIDATION_OBJECTS = ("4", "11", "15")
"""Of the objects that no trial lifts, those that choose the epoch."""
TITLES = {TOSKOV: "Toskov et al. (wrench, GRU)", ANGLENET: f"AngleNet ({BACKBONE})"}
LIFTS = {TOSKOV: 120, ANGLENET: 5}
EPOCHS = {TOSKOV: 120, ANGLENET: 8}
"""Simulated lifts of each object to learn from, and epochs, unless told otherwise."""


@dataclass(frozen=True, slots=True)
class AngleSettings:
    """What is trained on what.

    name: `anglenet` or `toskov`. sessions: of rig trial, simulated lifts where empty. lifts: simulated
    ones of each object to learn from. on_test_lifts: learn from the very lifts that are then scored, as
    the paper does. threads: of torch, None for its own choice.
    """

    name: str
    sessions: tuple[Path, ...]
    lifts: int
    epochs: int
    seed: int
    on_test_lifts: bool = False
    threads: int | None = None


@dataclass(frozen=True, slots=True)
class Split:
    """Objects to learn from, to choose the epoch by, and to score, by id."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


def train_angles(out: Path, settings: AngleSettings, tell: Tell) -> dict[str, Any]:
    """Train one network; write model and card into the folder, and return the card.

    Raises `InputError` for a folder that holds something or cannot be made, or sessions that cannot be
    split.
    """
    claim(out)
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    result = (_train_wrist if settings.name == TOSKOV else _train_angle_net)(out, settings, tell)
    card = {
        "name": settings.name,
        "title": TITLES[settings.name],
        "data": [str(s) for s in settings.sessions] or "simulated lifts",
        "simulated": all(_is_simulated(s) for s in settings.sessions),
        "trained_on_test_lifts": settings.on_test_lifts,
        "seed": settings.seed,
        "epochs": settings.epochs,
        "torch": str(torch.__version__),
        **result,
    }
    write_json(out / CARD, card)
    return card


def _is_simulated(session: Path) -> bool:
    return read_manifest_of(session, TrialManifest, "angles are learnt from lifts").simulated


def split_objects(present: Sequence[str], on_test_lifts: bool, where: str) -> Split:
    """Split by objects: the trial's are scored, three others choose the epoch, the rest teaches.

    on_test_lifts: all of them do everything. Raises `InputError` where a part would be empty.
    """
    found = tuple(dict.fromkeys(present))
    if on_test_lifts:
        return Split(found, found, found)
    split = Split(
        tuple(i for i in found if i not in (*TRIAL_OBJECTS, *VALIDATION_OBJECTS)),
        tuple(i for i in found if i in VALIDATION_OBJECTS),
        tuple(i for i in found if i in TRIAL_OBJECTS),
    )
    if not (split.train and split.validation and split.test):
        raise InputError(
            f"{where}: has lifts of {', '.join(found)}; to hold objects back it takes some of the trial's "
            f"({', '.join(TRIAL_OBJECTS)}) to score, of {', '.join(VALIDATION_OBJECTS)} to choose the epoch, "
            "and others to learn from: add sessions, or learn from the test lifts with --on-test-lifts"
        )
    return split


def _train_wrist(out: Path, settings: AngleSettings, tell: Tell) -> dict[str, object]:
    lifts, split = _wrists(settings, tell)
    parts = [sequences([x for x in lifts if x.object_id in ids]) for ids in _ids(split)]
    network, errors = train_wrist(parts[0], parts[1], settings.epochs, settings.seed, _shown(settings, tell))
    export_wrist(network, out / MODEL)
    test = {"error_deg": error_deg(network, parts[2]), "saying_zero_deg": blind_error_deg(parts[2])}
    return {
        "parameters": sum(p.numel() for p in network.parameters()),
        "objects": _named(split),
        "lifts": dict(zip(("train", "validation", "test"), (len(p.wrench) for p in parts), strict=True)),
        "validation_deg": errors,
        "test": test,
        "files": {"fp32": ExportedFile("fp32", out / MODEL).facts()},
    }


def _train_angle_net(out: Path, settings: AngleSettings, tell: Tell) -> dict[str, object]:
    views, split = _views(settings, tell)
    train, validation, test = (views.of(ids) for ids in _ids(split))
    network, errors = train_angle_net(
        train, validation, settings.epochs, settings.seed, not settings.on_test_lifts, _shown(settings, tell)
    )
    export_angle_net(network, out / MODEL, out / HALF)
    spread = float(np.abs(test.angle_deg).mean())
    return {
        "parameters": sum(p.numel() for p in network.parameters()),
        "size_px": list(SIZE),
        "objects": _named(split),
        "images": {"train": len(train), "validation": len(validation), "test": len(test)},
        "validation_deg": errors,
        "test": {"error_deg": views_error_deg(network, test), "saying_zero_deg": spread},
        "files": {p: ExportedFile(p, out / f).facts() for p, f in (("fp32", MODEL), ("fp16", HALF))},
    }


def _wrists(settings: AngleSettings, tell: Tell) -> tuple[list[WristSeries], Split]:
    if settings.sessions:
        lifts = [lift.wrist() for lift in stored_lifts(settings.sessions)]
        return lifts, _stored_split([x.object_id for x in lifts], settings)
    split = _simulated_split(settings)
    parts = [
        simulated_wrists(ids, count, settings.seed * 3 + number, _lifted(tell))
        for number, (ids, count) in enumerate(_counts(split, settings))
    ]
    return [lift for part in parts for lift in part], split


def _views(settings: AngleSettings, tell: Tell) -> tuple[GelViews, Split]:
    if settings.sessions:
        stored = [view for lift in stored_lifts(settings.sessions) for view in lift.views(SIZE)]
        views = stacked_views(stored, "the sessions")
        return views, _stored_split(views.objects, settings)
    split = _simulated_split(settings)
    made = [
        view
        for number, (ids, count) in enumerate(_counts(split, settings))
        for view in simulated_views(ids, count, settings.seed * 3 + number, SIZE, _lifted(tell))
    ]
    return stacked_views(made, "simulated lifts"), split


def _simulated_split(settings: AngleSettings) -> Split:
    if settings.on_test_lifts:
        raise InputError("--on-test-lifts needs the lifts: give their session with --data")
    return split_objects(list(load_grasp_files()), False, "the catalogue")


def _stored_split(present: Sequence[str], settings: AngleSettings) -> Split:
    return split_objects(present, settings.on_test_lifts, ", ".join(map(str, settings.sessions)))


def _counts(split: Split, settings: AngleSettings) -> list[tuple[tuple[str, ...], int]]:
    """Objects and simulated lifts of each: many to learn from, a third to choose by, a sixth to score."""
    few, least = max(2, settings.lifts // 3), max(2, settings.lifts // 6)
    return list(zip(_ids(split), (settings.lifts, few, least), strict=True))


def _ids(split: Split) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    return split.train, split.validation, split.test


def _named(split: Split) -> dict[str, list[str]]:
    return {"train": list(split.train), "validation": list(split.validation), "test": list(split.test)}


def _lifted(tell: Tell) -> Callable[[int, int], None]:
    return lambda done, total: tell("simulated lifts", done / total)


def _shown(settings: AngleSettings, tell: Tell) -> Callable[[int, float, float], None]:
    def show(epoch: int, loss: float, error: float) -> None:
        done = f"{settings.name}: epoch {epoch} of {settings.epochs}"
        tell(f"{done}, loss {loss:.2f} deg, validation {error:.2f} deg", epoch / settings.epochs)

    return show
