"""Training loops, and the batches of labelled frames, augmented each time a network sees them."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.network import NetworkInput, compared_planes, frame_planes
from rig.tactile.contact.relative import RelativeDifference
from rig.training.examples import Examples
from rig.training.networks import Architecture, build_network, fill_encoder, read_checkpoint

Report = Callable[[str, float], None]
"""Takes the progress of a training: a description, and the finished share of what it describes."""
Planes = NDArray[np.float32]

SHADED_SHARE, PART_SHARE = 0.4, 0.35
"""Shares of the varied frames: with dark corners; enlarged so that the border cuts contacts."""
GHOST_REACH = 12
"""Frames at most this far apart in a set mostly come from the same sensor unit."""

Batch = tuple[torch.Tensor, torch.Tensor]


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """One labelled frame: frame and background (h, w, 3) uint8 RGB, label (h, w) uint8."""

    frame: Image
    background: Image
    label: Image


def augment(sample: LabelledFrame, ghost: Image, varied: bool, rng: np.random.Generator) -> LabelledFrame:
    """Return the sample under other light, noise, place and scale.

    ghost: another frame of the same unit, which may be blended faintly into the background, like the residual
    contacts of a background that was estimated from frames. varied: whether corners and sides may be dark and
    a frame may show only part of the gel, for networks that must generalise to other makes of sensor.

    The order of the colours is kept and nothing is mirrored, because the networks infer shading from the
    positions of the LEDs (measured on real frames: flips cost 0.06 to 0.14 IoU).
    """
    frame, background = sample.frame.astype(np.float32), sample.background.astype(np.float32)
    if varied and rng.random() < SHADED_SHARE:
        # dark corners and sides, like at the edges of real gels
        coarse = 1.0 - np.float32(rng.uniform(0.3, 0.85)) * rng.random((3, 3), np.float32) ** 2
        shade = np.asarray(cv2.resize(coarse, frame.shape[1::-1], interpolation=cv2.INTER_CUBIC), np.float32)
        frame, background = frame * shade[..., None], background * shade[..., None]
    if rng.random() < 0.25:
        background += np.float32(rng.uniform(0.05, 0.30)) * (ghost.astype(np.float32) - background)
    frame, background = _relight(frame, background, rng)
    images, label = [_bytes(frame), _bytes(background)], sample.label
    if rng.random() < 0.6:
        images, label = _move(images, label, varied, rng)
    if rng.random() < 0.4:
        blur_px = float(rng.uniform(0.3, 1.5))
        images = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8) for image in images]
    return LabelledFrame(images[0], images[1], label)


def _relight(frame: Planes, background: Planes, rng: np.random.Generator) -> tuple[Planes, Planes]:
    """Drift between background and frame, another exposure of both, noise, and smooth patches of light."""
    both = np.exp(rng.normal(0.0, 0.2, 3)).astype(np.float32)
    drift = np.exp(rng.normal(0.0, 0.06, 3)).astype(np.float32)
    frame = np.asarray(frame * (drift * both) + rng.normal(0.0, 1.5, 3), np.float32)
    noise = rng.standard_normal(frame.shape, np.float32)
    frame += np.float32(rng.uniform(0.0, 2.5)) * noise
    if rng.random() < 0.4:
        coarse = rng.standard_normal((int(rng.integers(3, 9)), int(rng.integers(3, 7)), 3), np.float32)
        patches = cv2.resize(coarse, frame.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        frame *= 1.0 + np.float32(rng.uniform(0.0, 0.06)) * patches
    return frame, background * both


def _move(
    images: list[Image], label: Image, parts: bool, rng: np.random.Generator
) -> tuple[list[Image], Image]:
    """Shift and scale all images alike, with reflected borders; if `parts`, enlarge some to a part."""
    rows, columns = label.shape
    zoom = float(np.exp(rng.uniform(-0.15, 0.20)))
    reach = 0.08
    if parts and rng.random() < PART_SHARE:
        zoom = float(rng.uniform(1.15, 1.7))
        reach = (zoom - 1.0) / 2.0
    across, down = rng.uniform(-reach, reach, 2) * (columns, rows)
    shifts = (1.0 - zoom) * columns / 2 + across, (1.0 - zoom) * rows / 2 + down
    change = np.array([[zoom, 0.0, shifts[0]], [0.0, zoom, shifts[1]]])
    moved = [
        np.asarray(cv2.warpAffine(image, change, (columns, rows), borderMode=cv2.BORDER_REFLECT), np.uint8)
        for image in (*images, label)
    ]
    return moved[:-1], moved[-1]


def _bytes(image: Planes) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def training_batches(
    examples: Examples, inputs: NetworkInput, size: tuple[int, int], count: int, rng: np.random.Generator
) -> Iterator[Batch]:
    """Yield one epoch of augmented batches in random order: planes (N, C, h, w), labels (N, 1, h, w), 0 to 1.

    size: (height, width). A last batch of fewer than `count` frames is left out, as it would upset
    the batch statistics, unless it is the only one.
    """
    order = rng.permutation(len(examples))
    count = min(count, len(order))
    varied = inputs is NetworkInput.FRAME_AND_DIFFERENCE
    for start in range(0, len(order) - count + 1, count):
        samples = []
        for place in order[start : start + count].tolist():
            first = place // GHOST_REACH * GHOST_REACH
            ghost = int(rng.integers(first, min(first + GHOST_REACH, len(examples))))
            samples.append(augment(_sample(examples, place), examples.frames[ghost], varied, rng))
        yield _batch(samples, inputs, size)


def plain_batches(
    examples: Examples, inputs: NetworkInput, size: tuple[int, int], count: int = 32
) -> Iterator[Batch]:
    """Yield all frames in order as they are, in batches as `training_batches`."""
    for start in range(0, len(examples), count):
        samples = [_sample(examples, i) for i in range(start, min(start + count, len(examples)))]
        yield _batch(samples, inputs, size)


def _sample(examples: Examples, place: int) -> LabelledFrame:
    return LabelledFrame(examples.frames[place], examples.backgrounds[place], examples.labels[place])


def _batch(samples: list[LabelledFrame], inputs: NetworkInput, size: tuple[int, int]) -> Batch:
    width_height = (size[1], size[0])
    planes, labels = [], []
    for sample in samples:
        if inputs is NetworkInput.FRAME:
            planes.append(frame_planes(sample.frame, width_height))
        else:
            planes.append(compared_planes(sample.frame, RelativeDifference(sample.background, width_height)))
        label = cv2.resize(sample.label, width_height, interpolation=cv2.INTER_AREA)
        labels.append(np.asarray(label, np.float32)[None] / np.float32(255.0))
    return torch.from_numpy(np.stack(planes)), torch.from_numpy(np.stack(labels))


_BRAIN_FLOAT_UNITS = ("amx_bf16", "avx512_bf16", "bf16")
"""Torch's names for hardware support of bfloat16: x86 (tiles, vectors) and ARM."""
FOCUS = 2.0
"""Exponent of the focal loss (Lin et al. 2017), the library's default, as the paper's script uses it."""
AVERAGING = 0.995
"""Decay of the averaged weights per step (Polyak averaging)."""
WARM_UP = 0.1
DICE_SMOOTHING_PX = 50.0


def arithmetic_of(device: torch.device) -> torch.dtype:
    """Return bfloat16 for a device that multiplies it, else float32.

    Layers then compute in bfloat16 (mixed precision, Micikevicius et al. 2018); weights, loss, optimizer and
    exported files stay float32. This at least halves the time; emulated bfloat16 would be slower.
    """
    if device.type == "cuda":
        able = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        # older versions of torch have no get_capabilities
        capabilities = getattr(torch.cpu, "get_capabilities", dict)()
        able = any(capabilities.get(unit, False) for unit in _BRAIN_FLOAT_UNITS)
    return torch.bfloat16 if able else torch.float32


@dataclass(frozen=True, slots=True)
class Schedule:
    """How a network is trained. rate: peak learning rate, constant unless `cycle` (one-cycle, Smith 2018)."""

    epochs: int
    batch: int
    rate: float
    cycle: bool


@dataclass(frozen=True, slots=True)
class Epoch:
    """Results of one epoch: mean loss, mean Dice on the validation objects, time including validation.

    wall_s, cpu_s: wall time, and processor time of all threads.
    """

    number: int
    loss: float
    validation_dice: float
    wall_s: float
    cpu_s: float


Progress = Callable[[Epoch | None, float], None]
"""Takes the finished share of an epoch, and at its end its results."""


class Training:
    """One network in training.

    seed: of weights, order and augmentation. The random numbers of an epoch depend only on the seed and the
    epoch's number, so a resumed training gives the same result.
    """

    def __init__(
        self, architecture: Architecture, encoder: str, size: tuple[int, int], schedule: Schedule, seed: int
    ) -> None:
        torch.manual_seed(seed)
        self.architecture, self.size, self.schedule, self._seed = architecture, size, schedule, seed
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.arithmetic = arithmetic_of(self._device)
        self.network = build_network(architecture, encoder).to(self._device)
        self.best = deepcopy(self.network.state_dict())
        self.history: list[Epoch] = []
        self._averaged = deepcopy(self.network).requires_grad_(False)
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=schedule.rate, fused=True)
        self._step = 0

    def load_encoder(self, path: Path) -> None:
        """Start from the encoder weights in a file (a state dict, as the library's encoders save it).

        Other weights in the file (a classifier's last layer) are ignored. Raises `InputError` if some of the
        encoder's weights are missing.
        """
        encoder = getattr(self.network, "encoder", None)
        if encoder is None:
            raise InputError(f"{path}: the network '{self.architecture.name}' has no encoder to load")
        fill_encoder(encoder, path)
        self._averaged.load_state_dict(self.network.state_dict())

    def run(
        self, train: Examples, validation: Examples, checkpoint: Path, progress: Progress = lambda *_: None
    ) -> None:
        """Train the remaining epochs; after each, store the state in `checkpoint`."""
        steps = max(1, len(train) // self.schedule.batch)
        while len(self.history) < self.schedule.epochs:
            number, wall_s, cpu_s = len(self.history) + 1, perf_counter(), process_time()
            loss, dice = self._epoch(train, number, steps, progress), self.dice(validation)
            epoch = Epoch(number, loss, dice, perf_counter() - wall_s, process_time() - cpu_s)
            if epoch.validation_dice >= max((e.validation_dice for e in self.history), default=0.0):
                self.best = deepcopy(self._averaged.state_dict())
            self.history.append(epoch)
            self.save(checkpoint)
            progress(epoch, 1.0)

    def best_network(self) -> nn.Module:
        """Return the network of the best epoch on the validation objects, in evaluation mode."""
        network = deepcopy(self._averaged)
        network.load_state_dict(self.best)
        return network.cpu().eval()

    def dice(self, examples: Examples) -> float:
        """Return the mean Dice of the averaged weights at the network's own resolution."""
        self._averaged.eval()
        level = float(np.log(self.architecture.threshold / (1.0 - self.architecture.threshold)))
        scores = []
        with torch.inference_mode():
            for planes, labels in plain_batches(examples, self.architecture.inputs, self.size):
                found, true = self._answer(self._averaged, planes).cpu() > level, labels > 0.5
                both, sum_ = (found & true).sum((1, 2, 3)), found.sum((1, 2, 3)) + true.sum((1, 2, 3))
                scores.append(torch.where(sum_ == 0, 1.0, 2.0 * both / sum_.clamp(min=1)))
        return float(torch.cat(scores).mean())

    def save(self, path: Path) -> None:
        """Write the state from which the training can be resumed."""
        aside = path.with_name(path.name + ".part")
        state = {
            "state_dict": self.best,
            "network": self.network.state_dict(),
            "averaged": self._averaged.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "step": self._step,
            "history": [asdict(epoch) for epoch in self.history],
        }
        torch.save(state, aside)
        aside.replace(path)

    def load(self, path: Path) -> None:
        """Restore a state. Raises `InputError` for a damaged file."""
        state = read_checkpoint(path)
        try:
            self.network.load_state_dict(state["network"])
            self._averaged.load_state_dict(state["averaged"])
            self._optimizer.load_state_dict(state["optimizer"])
            self.best, self._step = state["state_dict"], int(state["step"])
            self.history = [Epoch(**epoch) for epoch in state["history"]]
        except (KeyError, TypeError, RuntimeError) as error:
            raise InputError(f"{path}: is not a state of this training ({error}): remove the file") from error

    def _epoch(self, train: Examples, number: int, steps: int, progress: Progress) -> float:
        rng = np.random.default_rng((self._seed, number))
        torch.manual_seed(self._seed * 100_003 + number)
        self.network.train()
        losses: list[float] = []
        batches = training_batches(train, self.architecture.inputs, self.size, self.schedule.batch, rng)
        for planes, labels in batches:
            self._optimizer.param_groups[0]["lr"] = self._rate(steps)
            logits, labels = self._answer(self.network, planes), labels.to(self._device)
            loss = (small_loss if self.architecture.family is None else focal_loss)(logits, labels)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            losses.append(loss.item())
            self._average()
            progress(None, len(losses) / steps)
        return float(np.mean(losses))

    def _answer(self, network: nn.Module, planes: torch.Tensor) -> torch.Tensor:
        planes = planes.to(self._device).contiguous(memory_format=torch.channels_last)
        mixed = self.arithmetic is torch.bfloat16
        with torch.autocast(self._device.type, torch.bfloat16, enabled=mixed):
            return network(planes).float()

    def _rate(self, steps: int) -> float:
        if not self.schedule.cycle:
            return self.schedule.rate
        done = self._step / (steps * self.schedule.epochs)
        if done < WARM_UP:
            return self.schedule.rate * (0.04 + 0.96 * done / WARM_UP)
        falling = 0.5 + 0.5 * float(np.cos(np.pi * (done - WARM_UP) / (1 - WARM_UP)))
        return self.schedule.rate * max(1e-3, falling)

    def _average(self) -> None:
        self._step += 1
        keep = min(AVERAGING, self._step / (self._step + 10.0))
        with torch.no_grad():
            pairs = zip(self._averaged.state_dict().values(), self.network.state_dict().values(), strict=True)
            for mean, new in pairs:
                if mean.dtype.is_floating_point:
                    mean.lerp_(new, 1.0 - keep)
                else:
                    mean.copy_(new)


def focal_loss(logits: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
    """Mean of (1 - p_t)^2 times the cross entropy (Lin et al. 2017); labels 0 to 1, soft at edges."""
    entropy = functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    share = torch.sigmoid(logits)
    return (torch.abs(labels - share) ** FOCUS * entropy).mean()


def small_loss(logits: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
    """Cross entropy, and half of one minus the mean Dice of shares (Milletari et al. 2016).

    The second part prevents missed small contacts.
    """
    share, over = torch.sigmoid(logits), (1, 2, 3)
    both, sum_ = (share * labels).sum(over), share.sum(over) + labels.sum(over)
    dice = ((2.0 * both + DICE_SMOOTHING_PX) / (sum_ + DICE_SMOOTHING_PX)).mean()
    return functional.binary_cross_entropy_with_logits(logits, labels) + 0.5 * (1.0 - dice)
