"""Compare the masks of a method with labels."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from rig.frames.masks import MakeSegmenter
from rig.labels.polygons import agreement
from rig.training.examples import Examples


@dataclass(frozen=True, slots=True)
class MaskScore:
    """Mean and standard deviation of Dice and IoU over frames.

    size_ratio: median of the root of the mask's area over the label's; None if no label has a contact. ms:
    median wall time, frame in to mask out.
    """

    dice: float
    dice_std: float
    iou: float
    iou_std: float
    size_ratio: float | None
    ms: float


def score_masks(make: MakeSegmenter, examples: Examples) -> MaskScore:
    """Segment every frame with its own background, and compare the mask with the label."""
    found, sizes, cost_s = [], [], []
    for frame, background, label in zip(examples.frames, examples.backgrounds, examples.labels, strict=True):
        segmenter = make(background)
        began = perf_counter()
        mask = segmenter.segment(frame).contact.mask
        cost_s.append(perf_counter() - began)
        mask = np.zeros(label.shape, np.uint8) if mask is None else mask
        true = np.where(label > 127, 255, 0).astype(np.uint8)
        found.append(agreement(mask, true))
        if true.any():
            sizes.append(np.sqrt(np.count_nonzero(mask) / np.count_nonzero(true)))
    dice, iou = ([getattr(one, name) for one in found] for name in ("dice", "iou"))
    return MaskScore(
        dice=float(np.mean(dice)),
        dice_std=float(np.std(dice)),
        iou=float(np.mean(iou)),
        iou_std=float(np.std(iou)),
        size_ratio=float(np.median(sizes)) if sizes else None,
        ms=1e3 * float(np.median(cost_s)),
    )
