"""Labelled frames as batches of planes for a network, augmented each time a network in training sees them."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.network import NetworkInput, compared_planes, frame_planes
from rig.tactile.contact.relative import RelativeDifference
from rig.training.examples import Examples

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


def augmented(sample: LabelledFrame, ghost: Image, varied: bool, rng: np.random.Generator) -> LabelledFrame:
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
    frame, background = _relit(frame, background, rng)
    images, label = [_bytes(frame), _bytes(background)], sample.label
    if rng.random() < 0.6:
        images, label = _moved(images, label, varied, rng)
    if rng.random() < 0.4:
        blur_px = float(rng.uniform(0.3, 1.5))
        images = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8) for image in images]
    return LabelledFrame(images[0], images[1], label)


def _relit(frame: Planes, background: Planes, rng: np.random.Generator) -> tuple[Planes, Planes]:
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


def _moved(
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
            samples.append(augmented(_sample(examples, place), examples.frames[ghost], varied, rng))
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
