"""The relative difference of parts of a frame, with the marks of the gel filled, by compiled loops."""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.gel_marks import GelMarks
from rig.tactile.contact.relative import SATURATED, RelativeDifference
from rig.tactile.slip.height import Box, Field
from rig.tactile.slip.pixels import subtract_light

Light = NDArray[np.float64]
"""Gain and offset per channel, (2, 3)."""


class Lit:
    """One copy of the frames. marked: mask of the marks, see `found_marks`."""

    def __init__(self, difference: RelativeDifference, marked: Image) -> None:
        self._difference = difference
        weight, relative = (np.ascontiguousarray(part.transpose(2, 0, 1)) for part in difference.terms)
        self._terms = weight, relative
        self.fill(marked)

    def fill(self, marked: Image) -> None:
        """Fill other marks from now on."""
        self._marks = GelMarks(marked, self._difference.size).table

    def reduce(self, image: Image) -> Image:
        """Return the reduced copy, (h, w, 3) uint8."""
        return self._difference.reduce(image)

    def light(self, work: Image) -> Light:
        """Return gain and offset of a reduced copy, see `RelativeDifference.light_of`."""
        return np.array(self._difference.light_of(work))

    def difference_with_marks(self, copy: Image, light: Light) -> Field:
        """Return the difference of a reduced copy with its marks, (h, w, 3)."""
        return self._difference.of(copy, (light[0], light[1]))

    def of(self, copy: Image, light: Light, box: Box) -> Field:
        """Return the difference of a reduced copy in a box of its pixels, (3, h, w)."""
        left, top, width, height = box
        planes, colours = np.empty((3, height, width), np.float32), np.empty((3, height, width), np.uint8)
        cv2.split(copy[top : top + height, left : left + width], list(colours))
        subtract_light(colours, (left, top), light, self._terms, self._marks, SATURATED, planes)
        return planes
