"""Compute the texture around a contact; the network from time to time.

The network predicts where the texture turns with the object. The noise floor is that of the first contact. No
frame pays for the network, the noise floor, and a search or a keyframe together.
"""

from dataclasses import replace

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.slip.height import Box, Field, contact_box, within
from rig.tactile.slip.light import Light, Lit
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES
from rig.tactile.slip.texture import BOX_PX, Texture, noise_floor, structure, tensor_of
from rig.tactile.slip.tracker import Tracker
from rig.tactile.slip.turning import shipped_turning

PATIENCE = 3.0
"""The network waits this many times as long while a better pose is searched for."""
NETWORK_PX = 9
"""Margin of the network's box around the contact, work pixels: the reach of the texture and its filters."""


class TextureStage:
    """The texture of one sensor. scale: pixels per work pixel; size: width and height of the fine copy."""

    def __init__(self, lit: Lit, scale: int, size: tuple[int, int]) -> None:
        self._lit, self._scale, self._network = lit, scale, shipped_turning()
        self._counts = np.full(size[::-1], KEYFRAMES.least_count, np.float32)
        self._clear: Field | None = None
        self._counts_ns = 0
        self._floor: float | None = None

    def of(
        self,
        fine: Image,
        clean: Field,
        light: Light,
        mask: Image,
        time_ns: int,
        tracker: Tracker,
        busy: bool = False,
    ) -> Texture:
        """Return the texture around a contact.

        fine: (h, w, 3) uint8, the fine copy of a frame. clean: difference of the work copy. mask: of the
        contact, in work pixels. tracker: its contact may be searched, or be without keyframe, which needs the
        network. busy: whether the frame has another long step.
        """
        contact = tracker.contact
        first, fresh = self._floor is None, contact is None
        box = (0, 0, clean.shape[1], clean.shape[0]) if first else contact_box(mask, BOX_PX)
        left, top, width, height = (self._scale * side for side in box)
        difference = self._lit.of(fine, light, (left, top, width, height))
        wait_s = ALIGNMENT.network_s * (PATIENCE if contact is not None and contact.search.disagrees else 1.0)
        if first or fresh or (not busy and time_ns - self._counts_ns >= wait_s * NS_PER_S):
            self._look(difference, (left, top), contact_box(mask, NETWORK_PX), time_ns)
        counts = self._counts[within((left, top, width, height))]
        if self._clear is not None:
            counts = counts * self._clear[top : top + height, left : left + width]
        tensor = tensor_of(difference, clean[within(box)], self._scale)
        if self._floor is None:
            self._floor = noise_floor(tensor)
        margins = left, top, self._counts.shape[1] - left - width, self._counts.shape[0] - top - height
        texture = structure(tensor, self._floor, np.ascontiguousarray(counts), margins, self._scale)
        return replace(texture, heavy=first or self._counts_ns == time_ns)

    def leave_out(self, marked: Image) -> None:
        """Give no weight to texture at later marks, whose filling is no texture. marked: (h, w) mask."""
        self._clear = np.asarray(cv2.dilate(marked, np.ones((3, 3), np.uint8)) == 0, np.float32)

    def _look(self, difference: Field, corner: tuple[int, int], box: Box, time_ns: int) -> None:
        """Run the network on a box, in work pixels, of a difference (3, h, w) that begins at a corner."""
        left, top = corner
        near = box[0] * self._scale, box[1] * self._scale, box[2] * self._scale, box[3] * self._scale
        x, y = near[0] - left, near[1] - top
        seen = difference[:, y : y + near[3], x : x + near[2]]
        around = top, top + difference.shape[1], left, left + difference.shape[2]
        self._counts[around[0] : around[1], around[2] : around[3]] = KEYFRAMES.least_count
        self._counts[within(near)] = self._network.counts(seen, self._scale)
        self._counts_ns = time_ns
