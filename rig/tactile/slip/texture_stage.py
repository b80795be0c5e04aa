"""Compute the texture around a contact; the network and the noise floor from time to time.

The network predicts where the texture turns with the object. Between two of its runs its map moves with the
object. No frame pays for the network, the noise floor, and a search or a keyframe together.
"""

import cmath
from dataclasses import replace

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.slip.alignment import Pose
from rig.tactile.slip.height import Box, Field, contact_box, within
from rig.tactile.slip.light import Light, Lit
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES
from rig.tactile.slip.texture import BOX_PX, Texture, noise_floor, structure, tensor_of
from rig.tactile.slip.tracker import Contact, Tracker
from rig.tactile.slip.turning import shipped_turning

FLOOR_S = 0.495
"""Period of the noise floor, which needs the whole image; the light of a sensor changes more slowly."""
PATIENCE = 3.0
"""The network waits this many times as long while a better pose is searched for."""
NETWORK_PX = 9
"""Margin of the network's box around the contact, work pixels: the reach of the texture and its filters."""
STILL_RAD, STILL_PX = 0.02, 0.5
"""The map of the network is not moved by less."""


class TextureStage:
    """The texture of one sensor. scale: pixels per work pixel; size: width and height of the fine copy."""

    def __init__(self, lit: Lit, scale: int, size: tuple[int, int]) -> None:
        self._lit, self._scale, self._network = lit, scale, shipped_turning()
        self._counts = np.full(size[::-1], KEYFRAMES.least_count, np.float32)
        self._clear: Field | None = None
        self._counts_ns = self._floor_ns = 0
        self._counts_pose: Pose | None = None
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
        idle = not (busy or fresh)
        settle = first or (idle and time_ns - self._floor_ns >= FLOOR_S * NS_PER_S)
        box = (0, 0, clean.shape[1], clean.shape[0]) if settle else contact_box(mask, BOX_PX)
        left, top, width, height = (self._scale * side for side in box)
        difference = self._lit.of(fine, light, (left, top, width, height))
        wait_s = ALIGNMENT.network_s * (PATIENCE if contact is not None and contact.disagrees else 1.0)
        if first or fresh or (idle and not settle and time_ns - self._counts_ns >= wait_s * NS_PER_S):
            self._look(difference, (left, top), contact_box(mask, NETWORK_PX), time_ns)
        counts = self._moved_counts(time_ns, contact, (left, top, width, height))
        if self._clear is not None:
            counts = counts * self._clear[top : top + height, left : left + width]
        tensor = tensor_of(difference, clean[within(box)], self._scale)
        floor = self._floor
        if settle or floor is None:
            self._floor = floor = noise_floor(tensor)
            self._floor_ns = time_ns
        margins = left, top, self._counts.shape[1] - left - width, self._counts.shape[0] - top - height
        texture = structure(tensor, floor, np.ascontiguousarray(counts), margins, self._scale)
        return replace(texture, heavy=settle or self._counts_ns == time_ns)

    def leave_out(self, marked: Image) -> None:
        """Give no weight to texture at later marks, whose filling is no texture. marked: (h, w) mask."""
        self._clear = np.asarray(cv2.dilate(marked, np.ones((3, 3), np.uint8)) == 0, np.float32)

    def placed(self, time_ns: int, contact: Contact | None) -> None:
        """Note where the object was when the network was run."""
        if self._counts_ns == time_ns:
            self._counts_pose = None if contact is None else contact.pose

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

    def _moved_counts(self, time_ns: int, contact: Contact | None, box: Box) -> Field:
        """Return the weights of the network in a box, moved with the object since they were computed."""
        here, before = self._counts[within(box)], self._counts_pose
        if self._counts_ns == time_ns or contact is None or before is None:
            return here
        now = contact.expected(time_ns / NS_PER_S)
        turned, moved = now.angle_rad - before.angle_rad, now.point_px - before.point_px
        if abs(turned) < STILL_RAD and abs(moved) < STILL_PX:
            return here
        # where each pixel of the box was; y is down, so the rotation is negative
        turn, middle = cmath.exp(1j * turned), (self._scale - 1) / 2.0 * (1 + 1j)
        origin = complex(*box[:2]) - self._scale * now.point_px - middle
        origin = self._scale * before.point_px + middle + turn * origin
        matrix = np.array([[turn.real, -turn.imag, origin.real], [turn.imag, turn.real, origin.imag]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(self._counts, matrix, box[2:], flags=flags, borderMode=cv2.BORDER_REPLICATE),
            np.float32,
        )
