"""Networks that estimate an angle: `anglenet` from one tactile image, `toskov` from the wrench at the wrist.

AngleNet: the paper compares with a larger network (section IV-D). Here it is replaced by the smallest
ConvNeXt of timm (zepto, 1.9 M parameters) on frames of reduced size. Toskov et al. 2022: one gated recurrent
unit and a linear layer. It is trained on whole lifts and exported as a single time step, with its memory as
input and output. To train one, run `python tools/train_angle.py --help`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from drivers.errors import InputError
from drivers.types import Image
from fitting import claim_folder, fit
from learnt_lifts import (
    AT_REST,
    SIGHT_HZ,
    GelViews,
    LearntLift,
    simulated_lifts,
    stack_views,
    stored_lifts,
)
from protocols.grasps import TRIAL_OBJECTS, load_grasp_files
from rig.sessions.files import write_json
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.tactile.contact.network import frame_planes
from rig.tactile.estimators import ANGLENET, TOSKOV
from rig.tactile.peers.learned import load_image_network, load_wrench_network
from rig.training import export
from rig.training.loop import Report
from rig.training.networks import declare_missing_operators

WHY = "angles are learnt from lifts"
VALIDATION_OBJECTS = ("4", "11", "15")
"""Objects outside the trial on which the best epoch is chosen."""
BACKBONE = "convnext_zepto_rms"
TITLES = {TOSKOV: "Toskov et al. (wrench, GRU)", ANGLENET: f"AngleNet ({BACKBONE})"}
LIFTS = {TOSKOV: 120, ANGLENET: 5}
EPOCHS = {TOSKOV: 120, ANGLENET: 8}
"""Default numbers of simulated training lifts per object, and of epochs."""
SHOWN = "{epoch}, loss {loss:.2f} deg, validation {error:.2f} deg"  # after an epoch
MOST_DIFFERENCE_DEG, MOST_DIFFERENCE_HALF_DEG = 0.01, 0.2
"""Largest accepted difference between the angles of a network and of its file, in full and half precision."""


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
    claim_folder(out, settings.threads)
    train = _train_wrist if settings.name == TOSKOV else _train_angle_net
    network, split, result = train(out, settings, report)
    card = {
        "name": settings.name,
        "title": TITLES[settings.name],
        "data": [str(s) for s in settings.sessions] or "simulated lifts",
        "simulated": all(read_manifest_of(s, TrialManifest, WHY).simulated for s in settings.sessions),
        "trained_on_test_lifts": settings.on_test_lifts,
        "seed": settings.seed,
        "epochs": settings.epochs,
        "torch": str(torch.__version__),
        "parameters": sum(p.numel() for p in network.parameters()),
        "objects": split._asdict(),
        **result,
    }
    write_json(out / export.CARD, card)
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
    if not all(split):
        raise InputError(
            f"{where}: has lifts of {', '.join(found)}. A split by objects needs some of "
            f"{', '.join(TRIAL_OBJECTS)} for the test, some of {', '.join(VALIDATION_OBJECTS)} for "
            "validation, and others for training: add sessions, or train on the test lifts with "
            "--on-test-lifts"
        )
    return split


Trained = tuple[nn.Module, Split, dict[str, object]]
"""A network, the objects, and further entries of its card."""


def _train_wrist(out: Path, settings: AngleSettings, report: Report) -> Trained:
    lifts = [(lift.object_id, lift.steps()) for lift in _lifts(settings, report, None)]
    split = _split([name for name, _ in lifts], settings)
    train, validation, test = (sequences([steps for name, steps in lifts if name in ids]) for ids in split)
    network, errors = train_wrist(train, validation, settings.epochs, settings.seed, report)
    export_wrist(network, out / export.MODEL)
    card: dict[str, object] = {
        "lifts": dict(zip(Split._fields, map(len, (train, validation, test)), strict=True)),
        "validation_deg": errors,
        "test": {"error_deg": wrist_error_deg(network, test), "saying_zero_deg": blind_error_deg(test)},
        "files": {"fp32": export.file_facts(out / export.MODEL)},
    }
    return network, split, card


def _train_angle_net(out: Path, settings: AngleSettings, report: Report) -> Trained:
    seen = [view for lift in _lifts(settings, report, SIGHT_HZ) for view in lift.views(SIZE)]
    views = stack_views(seen, "the sessions" if settings.sessions else "simulated lifts")
    split = _split(views.objects, settings)
    train, validation, test = parts = [views.of(ids) for ids in split]
    augment = not settings.on_test_lifts
    network, errors = train_angle_net(train, validation, settings.epochs, settings.seed, augment, report)
    files = {"fp32": out / export.MODEL, "fp16": out / export.HALF}
    export_angle_net(network, *files.values())
    spread = float(np.abs(test.angle_deg).mean())
    card: dict[str, object] = {
        "size_px": list(SIZE),
        "images": dict(zip(Split._fields, map(len, parts), strict=True)),
        "validation_deg": errors,
        "test": {"error_deg": views_error_deg(network, test), "saying_zero_deg": spread},
        "files": {precision: export.file_facts(file) for precision, file in files.items()},
    }
    return network, split, card


def _lifts(settings: AngleSettings, report: Report, sight_hz: float | None) -> Iterator[LearntLift]:
    """Yield the lifts of the sessions or, without any, simulated lifts of all objects."""
    if settings.sessions:
        yield from stored_lifts(settings.sessions)
        return
    counts = settings.lifts, max(2, settings.lifts // 3), max(2, settings.lifts // 6)
    for number, (ids, count) in enumerate(zip(_split((), settings), counts, strict=True)):
        yield from simulated_lifts(
            ids, count, settings.seed * 3 + number, lambda n, of: report("simulated lifts", n / of), sight_hz
        )


def _split(present: Sequence[str], settings: AngleSettings) -> Split:
    """Split the objects that are present in the sessions or, without sessions, those of the catalogue."""
    if settings.sessions:
        return split_objects(present, settings.on_test_lifts, ", ".join(map(str, settings.sessions)))
    if settings.on_test_lifts:
        raise InputError("--on-test-lifts needs the lifts: give their session with --data")
    return split_objects(list(load_grasp_files()), False, "the catalogue")


SIZE = (72, 96)
"""(width, height) of AngleNet's input in px."""
BATCH, RATE = 32, 2e-3
ANGLE_DEG = 20.0
GREY, CONTRAST = 0.4, 0.2
"""Roughly mean and spread of a DIGIT's frame on a scale of 0 to 1."""
TURN_DEG, SHIFT, LIGHT, NOISE = 15.0, 0.06, 0.1, 2.0
"""Augmentation: largest rotation and shift (fraction of the image); sigmas of the log light and of noise."""


class AngleNet(nn.Module):
    """Frames (N, 3, h, w), 0 to 1, to image angles (N,) in degrees."""

    def __init__(self) -> None:
        super().__init__()
        declare_missing_operators()
        import timm

        # without layer scale, which starts near zero: short trainings would end before the blocks contribute
        self.backbone = timm.create_model(BACKBONE, pretrained=False, num_classes=1, ls_init_value=None)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        return ANGLE_DEG * self.backbone((planes - GREY) / CONTRAST)[:, 0]


def train_angle_net(
    train: GelViews, validation: GelViews, epochs: int, seed: int, augment: bool, report: Report
) -> tuple[AngleNet, list[float]]:
    """Train; return the network of the best epoch, and the validation error of each epoch.

    augment: whether frames are rotated, shifted and relit each time they are used.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    # bfloat16 is not faster here, because most of the time is spent in depthwise convolutions
    network = AngleNet().to(memory_format=torch.channels_last)

    def loss(at: torch.Tensor) -> torch.Tensor:
        seen = [(train.images[i], float(train.angle_deg[i])) for i in at.tolist()]
        seen = [_augment(*of, rng) for of in seen] if augment else seen
        found = network(_planes([image for image, _ in seen]))
        return functional.l1_loss(found, torch.tensor([angle for _, angle in seen]))

    validate = partial(views_error_deg, network, validation)
    shown = f"{ANGLENET}: {SHOWN}"
    return network, fit(network, epochs, BATCH, RATE, len(train), loss, validate, report, shown)


def views_error_deg(network: AngleNet, views: GelViews) -> float:
    """Return the mean absolute error of single frames, without subtracting a zero."""
    starts = range(0, len(views), BATCH)
    with torch.inference_mode():
        found = [network(_planes(views.images[start : start + BATCH])).numpy() for start in starts]
    return float(np.abs(np.concatenate(found) - views.angle_deg).mean())


def export_angle_net(network: AngleNet, full: Path, half: Path) -> None:
    """Write a network in full precision and with half-precision weights. Raises `RigError` if they differ."""
    width, height = SIZE
    frame = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0))
    onnx.save(export.onnx_model(network, {"frame": frame}, ["angle_deg"]), full)
    export.export_half(full, half)
    image = (frame[0].numpy().transpose(1, 2, 0) * 255.0).astype(np.uint8)
    seen = torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32) / 255.0)
    with torch.inference_mode():
        own = network(seen).numpy()
    for path, most in ((full, MOST_DIFFERENCE_DEG), (half, MOST_DIFFERENCE_HALF_DEG)):
        export.check_agreement(path, load_image_network(path).angle_deg(image) - own, most, " deg")


def _planes(images: Sequence[Image] | Image) -> torch.Tensor:
    planes = torch.from_numpy(np.stack([frame_planes(image, SIZE) for image in images]))
    return planes.contiguous(memory_format=torch.channels_last)


def _augment(image: Image, angle_deg: float, rng: np.random.Generator) -> tuple[Image, float]:
    turn = float(rng.uniform(-TURN_DEG, TURN_DEG))
    height, width = image.shape[:2]
    change = cv2.getRotationMatrix2D((width / 2.0, height / 2.0), turn, 1.0)
    change[:, 2] += rng.uniform(-SHIFT, SHIFT, 2) * (width, height)
    moved = cv2.warpAffine(image, change, (width, height), borderMode=cv2.BORDER_REFLECT)
    light = np.exp(rng.normal(0.0, LIGHT, 3)) * math.exp(float(rng.normal(0.0, LIGHT)))
    lit = moved * light + rng.normal(0.0, NOISE, moved.shape)
    return np.clip(lit, 0.0, 255.0).astype(np.uint8), angle_deg + turn


HIDDEN = 32
WRIST_BATCH, WRIST_RATE = 64, 4e-3
FORCE_N, TORQUE_NM, WRIST_ANGLE_DEG = 0.3, 0.01, 10.0
"""Scales of the wrist network's inputs and output, which are then about 1."""
MIRRORED = (-1.0, 1.0, 1.0, 1.0, -1.0, -1.0)
"""Signs of a wrench mirrored across the hand: force x and torque y and z change sign."""
CHECKED_STEPS = 20


class WrenchNetwork(nn.Module):
    """Wrenches (N, T, 6), N and N m, and memory (1, N, H) to angles (N, T) in degrees and the new memory."""

    def __init__(self) -> None:
        super().__init__()
        self.unit = nn.GRU(6, HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, 1)
        self.register_buffer("scale", torch.tensor([FORCE_N] * 3 + [TORQUE_NM] * 3))

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        felt, memory = self.unit(wrench / self.scale, memory)
        return self.angle_deg(felt), memory

    def angle_deg(self, felt: torch.Tensor) -> torch.Tensor:
        return WRIST_ANGLE_DEG * self.head(felt)[..., 0]


class WrenchStep(nn.Module):
    """One step of a `WrenchNetwork`: wrench (1, 1, 6) and memory (1, 1, H) to angle (1, 1) and memory."""

    def __init__(self, network: WrenchNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, wrench: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        unit, before = self.network.unit, memory[0]
        felt = (wrench / self.network.scale)[0] @ unit.weight_ih_l0.T + unit.bias_ih_l0
        kept = before @ unit.weight_hh_l0.T + unit.bias_hh_l0
        # gates in torch's order: reset, update, new (Cho et al. 2014)
        (reset, update, new), (reset_kept, update_kept, new_kept) = felt.chunk(3, -1), kept.chunk(3, -1)
        fresh = torch.tanh(new + torch.sigmoid(reset + reset_kept) * new_kept)
        share = torch.sigmoid(update + update_kept)
        after = (1.0 - share) * fresh + share * before
        return self.network.angle_deg(after), after[None]


def sequences(lifts: Sequence[NDArray[np.float32]]) -> torch.Tensor:
    """Return the steps of lifts (`LearntLift.steps`), padded with zeros to the longest, (N, T, 8)."""
    steps = np.zeros((len(lifts), max(map(len, lifts)), 8), np.float32)
    for row, of in zip(steps, lifts, strict=True):
        row[: len(of)] = of
    return torch.from_numpy(steps)


def train_wrist(
    train: torch.Tensor, validation: torch.Tensor, epochs: int, seed: int, report: Report
) -> tuple[WrenchNetwork, list[float]]:
    """Train; return the network of the best epoch, and the validation error of each epoch.

    train, validation: see `sequences`. A random half of each batch is mirrored.
    """
    torch.manual_seed(seed)
    network, mirrored = WrenchNetwork(), torch.tensor(MIRRORED)

    def loss(at: torch.Tensor) -> torch.Tensor:
        side = torch.where(torch.rand(len(at), 1) < 0.5, 1.0, -1.0)
        wrench, angle, weight = _parts(train[at])
        wrench = wrench * torch.where(side[..., None] < 0.0, mirrored, torch.ones(6))
        found, _ = network(wrench, _blank(len(at)))
        return (weight * (found - side * angle).abs()).sum() / weight.sum()

    validate = partial(wrist_error_deg, network, validation)
    shown, many = f"{TOSKOV}: {SHOWN}", len(train)
    return network, fit(network, epochs, WRIST_BATCH, WRIST_RATE, many, loss, validate, report, shown)


def wrist_error_deg(network: WrenchNetwork, steps: torch.Tensor) -> float:
    """Return the mean absolute error over phases B and C."""
    wrench, angle, weight = _parts(steps)
    with torch.inference_mode():
        found, _ = network(wrench, _blank(len(wrench)))
    return float((found - angle).abs()[weight > AT_REST].mean())


def blind_error_deg(steps: torch.Tensor) -> float:
    """Return the mean absolute error of always predicting 0, over phases B and C."""
    _, angle, weight = _parts(steps)
    return float(angle[weight > AT_REST].abs().mean())


def export_wrist(network: WrenchNetwork, path: Path) -> None:
    """Write a network as one time step. Raises `RigError` if the file disagrees with the network."""
    inputs = {"wrench": torch.zeros(1, 1, 6), "memory": torch.zeros(1, 1, HIDDEN)}
    onnx.save(export.onnx_model(WrenchStep(network), inputs, ["angle_deg", "memory_after"]), path)
    wrench = torch.randn(1, CHECKED_STEPS, 6, generator=torch.Generator().manual_seed(0)) * network.scale
    with torch.inference_mode():
        own = network(wrench, inputs["memory"])[0][0].numpy()
    loaded = load_wrench_network(path)
    memory, angles_deg = loaded.blank(), []
    for step in wrench[0].numpy():
        angle, memory = loaded.step(step, memory)
        angles_deg.append(angle)
    export.check_agreement(path, np.array(angles_deg) - own, MOST_DIFFERENCE_DEG, " deg")


def _parts(steps: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return wrenches (N, T, 6), angles (N, T) and weights (N, T)."""
    return steps[..., :6].contiguous(), steps[..., 6].contiguous(), steps[..., 7].contiguous()


def _blank(count: int) -> torch.Tensor:
    return torch.zeros(1, count, HIDDEN)
