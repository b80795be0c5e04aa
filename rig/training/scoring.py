"""A network's score on labelled frames, through the same path that users' frames take."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from rig.labels.scores import agreement
from rig.tactile.contact.network import Network
from rig.tactile.contact.segmenter import Segmenter
from rig.training.examples import Examples


@dataclass(frozen=True, slots=True)
class MaskScore:
    """Mean and standard deviation of Dice and IoU over frames; median wall time, frame in to mask out, ms."""

    dice: float
    dice_std: float
    iou: float
    iou_std: float
    ms: float


def score(network: Network, examples: Examples) -> MaskScore:
    """Segment every frame and compare with its label."""
    dice, iou, cost_s = [], [], []
    for frame, background, label in zip(examples.frames, examples.backgrounds, examples.labels, strict=True):
        segmenter = Segmenter(network, background)
        began = perf_counter()
        mask = segmenter.find(frame).mask
        cost_s.append(perf_counter() - began)
        found = agreement(mask, np.where(label > 127, 255, 0).astype(np.uint8))
        dice.append(found.dice)
        iou.append(found.iou)
    return MaskScore(
        float(np.mean(dice)),
        float(np.std(dice)),
        float(np.mean(iou)),
        float(np.std(iou)),
        1e3 * float(np.median(cost_s)),
    )
