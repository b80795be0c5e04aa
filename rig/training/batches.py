"""Labelled frames as batches of planes for a network."""

from collections.abc import Iterator

import cv2
import numpy as np
import torch

from rig.tactile.contact.network_input import NetworkInput, compared_planes, frame_planes
from rig.tactile.contact.relative import RelativeDifference
from rig.training.augmentation import LabelledFrame, augmented
from rig.training.examples import Examples

GHOST_REACH = 12
"""Frames this near to one another are mostly of one sensor unit."""

Batch = tuple[torch.Tensor, torch.Tensor]


def training_batches(
    examples: Examples, inputs: NetworkInput, size: tuple[int, int], count: int, rng: np.random.Generator
) -> Iterator[Batch]:
    """Yield one epoch of augmented batches in random order: planes (N, C, h, w), labels (N, 1, h, w), 0 to 1.

    size: (height, width). A last batch of fewer than `count` frames is left out, as it would upset
    the batch statistics, unless it is the only one.
    """
    order = rng.permutation(len(examples))
    count = min(count, len(order))
    for start in range(0, len(order) - count + 1, count):
        samples = [_augmented(examples, int(place), inputs, rng) for place in order[start : start + count]]
        yield _batch(samples, inputs, size)


def plain_batches(
    examples: Examples, inputs: NetworkInput, size: tuple[int, int], count: int = 32
) -> Iterator[Batch]:
    """Yield all frames in order as they are, in batches as `training_batches`."""
    for start in range(0, len(examples), count):
        samples = [_sample(examples, i) for i in range(start, min(start + count, len(examples)))]
        yield _batch(samples, inputs, size)


def _augmented(
    examples: Examples, place: int, inputs: NetworkInput, rng: np.random.Generator
) -> LabelledFrame:
    first = place // GHOST_REACH * GHOST_REACH
    ghost = int(rng.integers(first, min(first + GHOST_REACH, len(examples))))
    varied = inputs is NetworkInput.FRAME_AND_DIFFERENCE
    return augmented(_sample(examples, place), examples.frames[ghost], varied, rng)


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
