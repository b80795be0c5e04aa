"""Training of the networks that estimate an angle: data, split by objects, export, card."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from drivers.errors import InputError
from protocols.grasps import TRIAL_OBJECTS, load_grasp_files
from rig.sessions.files import write_json
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.tactile.estimators import ANGLENET, TOSKOV
from rig.training.angle_net import BACKBONE, SIZE, export_angle_net, train_angle_net
from rig.training.angle_net import error_deg as views_error_deg
from rig.training.export import CARD, HALF, MODEL, Report, claim, file_facts
from rig.training.lifts import SIGHT_HZ, LearntLift, simulated_lifts, stacked_views, stored_lifts
from rig.training.loop import EpochReport
from rig.training.wrist import blind_error_deg, error_deg, export_wrist, sequences, train_wrist

WHY = "angles are learnt from lifts"
VALIDATION_OBJECTS = ("4", "11", "15")
"""Objects outside the trial on which the best epoch is chosen."""
TITLES = {TOSKOV: "Toskov et al. (wrench, GRU)", ANGLENET: f"AngleNet ({BACKBONE})"}
LIFTS = {TOSKOV: 120, ANGLENET: 5}
EPOCHS = {TOSKOV: 120, ANGLENET: 8}
"""Default numbers of simulated training lifts per object, and of epochs."""


@dataclass(frozen=True, slots=True)
class AngleSettings:
    """Settings of one training.

    name: `anglenet` or `toskov`. sessions: of rig trial; empty: simulated lifts. lifts: simulated training
    lifts per object. on_test_lifts: train on the lifts that are scored, as the paper does. threads: of torch,
    None for its default.
    """

    name: str
    sessions: tuple[Path, ...]
    lifts: int
    epochs: int
    seed: int
    on_test_lifts: bool = False
    threads: int | None = None


class Split(NamedTuple):
    """Ids of the objects to train on, to choose the best epoch on, and to score."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


def train_angles(out: Path, settings: AngleSettings, report: Report) -> dict[str, Any]:
    """Train one network; write model and card into the folder, and return the card.

    Raises `InputError` if the folder is not empty or cannot be made, or if the sessions cannot be split.
    """
    claim(out, settings.threads)
    result = (_train_wrist if settings.name == TOSKOV else _train_angle_net)(out, settings, report)
    card = {
        "name": settings.name,
        "title": TITLES[settings.name],
        "data": [str(s) for s in settings.sessions] or "simulated lifts",
        "simulated": all(read_manifest_of(s, TrialManifest, WHY).simulated for s in settings.sessions),
        "trained_on_test_lifts": settings.on_test_lifts,
        "seed": settings.seed,
        "epochs": settings.epochs,
        "torch": str(torch.__version__),
        **result,
    }
    write_json(out / CARD, card)
    return card


def split_objects(present: Sequence[str], on_test_lifts: bool, where: str) -> Split:
    """Split by objects: score those of the trial, validate on three others, train on the rest.

    on_test_lifts: use all objects for everything. Raises `InputError` if a part would be empty.
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
            f"{where}: has lifts of {', '.join(found)}. A split by objects needs some of "
            f"{', '.join(TRIAL_OBJECTS)} for the test, some of {', '.join(VALIDATION_OBJECTS)} for "
            "validation, and others for training: add sessions, or train on the test lifts with "
            "--on-test-lifts"
        )
    return split


def _train_wrist(out: Path, settings: AngleSettings, report: Report) -> dict[str, object]:
    lifts = [lift.wrist() for lift in _lifts(settings, report, None)]
    split = _split([lift.object_id for lift in lifts], settings)
    parts = [sequences([lift for lift in lifts if lift.object_id in ids]) for ids in split]
    show, test = _epoch_report(settings, report), parts[2]
    network, errors = train_wrist(parts[0], parts[1], settings.epochs, settings.seed, show)
    export_wrist(network, out / MODEL)
    return {
        "parameters": sum(p.numel() for p in network.parameters()),
        "objects": split._asdict(),
        "lifts": dict(zip(Split._fields, (len(part.wrench) for part in parts), strict=True)),
        "validation_deg": errors,
        "test": {"error_deg": error_deg(network, test), "saying_zero_deg": blind_error_deg(test)},
        "files": {"fp32": file_facts(out / MODEL)},
    }


def _train_angle_net(out: Path, settings: AngleSettings, report: Report) -> dict[str, object]:
    seen = [view for lift in _lifts(settings, report, SIGHT_HZ) for view in lift.views(SIZE)]
    views = stacked_views(seen, "the sessions" if settings.sessions else "simulated lifts")
    split = _split(views.objects, settings)
    train, validation, test = (views.of(ids) for ids in split)
    show = _epoch_report(settings, report)
    network, errors = train_angle_net(
        train, validation, settings.epochs, settings.seed, not settings.on_test_lifts, show
    )
    export_angle_net(network, out / MODEL, out / HALF)
    spread = float(np.abs(test.angle_deg).mean())
    return {
        "parameters": sum(p.numel() for p in network.parameters()),
        "size_px": list(SIZE),
        "objects": split._asdict(),
        "images": {"train": len(train), "validation": len(validation), "test": len(test)},
        "validation_deg": errors,
        "test": {"error_deg": views_error_deg(network, test), "saying_zero_deg": spread},
        "files": {p: file_facts(out / f) for p, f in (("fp32", MODEL), ("fp16", HALF))},
    }


def _lifts(settings: AngleSettings, report: Report, sight_hz: float | None) -> Iterator[LearntLift]:
    """Yield the lifts of the sessions or, without any, simulated lifts of all objects."""
    if settings.sessions:
        yield from stored_lifts(settings.sessions)
        return
    few, least, seed = max(2, settings.lifts // 3), max(2, settings.lifts // 6), settings.seed * 3
    for number, (ids, count) in enumerate(
        zip(_split((), settings), (settings.lifts, few, least), strict=True)
    ):
        yield from simulated_lifts(
            ids, count, seed + number, lambda n, total: report("simulated lifts", n / total), sight_hz
        )


def _split(present: Sequence[str], settings: AngleSettings) -> Split:
    """Split the objects that are present in the sessions or, without sessions, those of the catalogue."""
    if settings.sessions:
        return split_objects(present, settings.on_test_lifts, ", ".join(map(str, settings.sessions)))
    if settings.on_test_lifts:
        raise InputError("--on-test-lifts needs the lifts: give their session with --data")
    return split_objects(list(load_grasp_files()), False, "the catalogue")


def _epoch_report(settings: AngleSettings, report: Report) -> EpochReport:
    def show(epoch: int, loss: float, error: float) -> None:
        done = f"{settings.name}: epoch {epoch} of {settings.epochs}"
        report(f"{done}, loss {loss:.2f} deg, validation {error:.2f} deg", epoch / settings.epochs)

    return show
