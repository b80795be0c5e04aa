"""How well two masks agree (paper, equations 1 and 2)."""

from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from drivers.types import Image


@dataclass(frozen=True, slots=True)
class Agreement:
    """Dice and IoU of one mask with its label, 0 to 1; both 1 where both are empty."""

    dice: float
    iou: float


def agreement(mask: Image | None, label: Image) -> Agreement:
    """Compare a mask, None for no contact, with a label; (H, W), not 0 inside. Raises `InputError`."""
    true = label > 0
    if mask is None:
        return Agreement(1.0, 1.0) if not true.any() else Agreement(0.0, 0.0)
    if mask.shape != label.shape:
        raise InputError(f"mask of shape {mask.shape} and label of shape {label.shape}: use one size")
    found = mask > 0
    both = int(np.count_nonzero(found & true))
    total = int(np.count_nonzero(found)) + int(np.count_nonzero(true))
    if total == 0:
        return Agreement(1.0, 1.0)
    return Agreement(2.0 * both / total, both / (total - both))
