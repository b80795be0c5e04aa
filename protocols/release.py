"""Check whether a tactile image still shows the contact that it showed while an object was held.

The contact detection that stops the closing compares a frame with one from before the grasp. After several
seconds of drifting light it may report contact on an untouched gel. A release is therefore verified with the
imprint of this contact: the fine structure that appeared with the contact must disappear when the fingers
open.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image

Imprint = NDArray[np.float32]
"""(H, 40, 3) fine structure of a tactile image: its logarithm, high-pass filtered with SMOOTH_PX."""

WIDTH_PX = 40
"""Width to which images are reduced before the comparison."""
SMOOTH_PX = 5.0
"""Sigma of the Gaussian whose output is subtracted, px of the reduced image."""
DARK = 10.0
"""Grey levels added before the logarithm, so that noise in dark pixels does not dominate."""
LEFT_SHARE = 0.6
"""Largest fraction of its imprint that may remain after a release. Measured on hard simulated lifts with
drifting light and gels that keep a print: at most 0.44 after 45 releases, at least 0.76 in 9 lifts whose
fingers did not open."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A contact of one fingertip. untouched: mean imprint before it. held: before the fingers opened."""

    serial: str
    untouched: Imprint
    held: Imprint

    def is_in(self, now: Imprint) -> bool:
        """Whether an image still shows this contact."""
        return share_left(self.untouched, self.held, now) > LEFT_SHARE


def imprint(image: Image) -> Imprint:
    """Return the fine structure of a tactile image, (H, W, 3) uint8 RGB."""
    size = (WIDTH_PX, max(1, round(image.shape[0] * WIDTH_PX / image.shape[1])))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    logarithm = np.log(small + DARK)
    return np.asarray(logarithm - cv2.GaussianBlur(logarithm, (0, 0), SMOOTH_PX), np.float32)


def share_left(untouched: Imprint, held: Imprint, now: Imprint) -> float:
    """Return the fraction of a contact's imprint that an image still shows: 1 all, 0 none (least squares).

    untouched: mean imprint of some frames before the grasp. held: imprint before the fingers opened. now:
    imprint of the image.
    """
    contact, rest = held - untouched, now - untouched
    energy = float(np.sum(contact * contact))
    return float(np.sum(rest * contact)) / energy if energy > 0.0 else 0.0
