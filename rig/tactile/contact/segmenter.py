"""Segment the contact with a network; the interface is that of `rig.tactile.contact.finder`.

The output of the network is scaled to the size of the frame before the threshold is applied, so outlines are
finer than the pixels of the network.
"""

from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.finder import NO_CONTACT, Contact
from rig.tactile.contact.network import Network, NetworkInput, compared_planes, frame_planes
from rig.tactile.contact.overlooked import overlooked_part
from rig.tactile.contact.relative import RelativeDifference
from rig.tactile.sample import check_frame

# Parts with less than this fraction of the largest part's area are specks.
PART_SHARE = 0.1
# Smallest area of a contact as a fraction of the frame, as in rig.tactile.contact.finder.
LEAST_SHARE = 0.006
# A frame is black if all pixels are below the first grey level. It is saturated if more than the fraction
# WHITE_SHARE of its pixels is above the second.
BLACK_LEVEL, WHITE_LEVEL, WHITE_SHARE = 12, 250, 0.5
MAX_MARGIN = 0.2


class FrameState(Enum):
    """State of a segmented frame; the values are used in tables."""

    CONTACT = "contact"
    NO_CONTACT = "no_contact"
    BLACK = "black"
    SATURATED = "saturated"


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """The contact in a frame, and the state of the frame."""

    contact: Contact
    state: FrameState


class Segmenter:
    """Segments the contact in the frames of one sensor with a network; frames are independent.

    background: (H, W, 3) uint8 RGB, a frame without contact; not needed for networks whose input is only the
    frame. margin: distance by which the outline is moved outwards (negative: inwards), as a fraction of the
    image width, -0.2 to 0.2; 0 matches the labels. alone: whether the parts that the network has missed are
    left out; they are found with the background only. Raises `InputError`.
    """

    def __init__(
        self, network: Network, background: Image | None = None, margin: float = 0.0, alone: bool = False
    ) -> None:
        self._network, self._margin, self._alone = network, check_margin(margin), alone
        self._shape: tuple[int, ...] | None = None
        self._reference: RelativeDifference | None = None
        if network.recipe.inputs is NetworkInput.FRAME_AND_DIFFERENCE:
            if background is None:
                raise InputError(
                    f"the network '{network.name}' compares with a frame without contact: give --background"
                )
            self._reference = RelativeDifference(background, network.size)
            self._shape = background.shape
        threshold = network.recipe.threshold
        self._level = float(np.log(threshold / (1.0 - threshold)))

    def find(self, image: Image) -> Contact:
        """Return the contact in an (H, W, 3) uint8 RGB frame. Raises `InputError` for an invalid frame."""
        return self.segment(image).contact

    def segment(self, image: Image) -> Segmentation:
        """Return the contact and the state of a frame; black and saturated frames have no contact."""
        check_frame(image, self._shape)
        state = frame_exposure(image)
        if state is not None:
            return Segmentation(NO_CONTACT, state)
        planes = self._planes(image)
        logits = self._network.logits(planes)
        size = (image.shape[1], image.shape[0])
        fine = cv2.resize(logits, size, interpolation=cv2.INTER_LINEAR)
        inside = np.asarray(fine > self._level, np.uint8)
        if self._reference is not None and not self._alone:
            more = overlooked_part(np.asarray(logits > self._level, np.uint8), planes[:3])
            if more is not None:
                inside |= np.asarray(cv2.resize(more, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        mask = _large_parts(inside, self._network.recipe.convex)
        if cv2.countNonZero(mask) < LEAST_SHARE * mask.size:
            return Segmentation(NO_CONTACT, FrameState.NO_CONTACT)
        return Segmentation(contact_of(moved_outline(mask, self._margin)), FrameState.CONTACT)

    def _planes(self, image: Image) -> NDArray[np.float32]:
        if self._reference is None:
            return frame_planes(image, self._network.size)
        return compared_planes(image, self._reference)


def check_margin(margin: float) -> float:
    """Return the margin. Raises `InputError` if it is out of range."""
    if not -MAX_MARGIN <= margin <= MAX_MARGIN:
        raise InputError(f"margin {margin:g} is out of range: choose -{MAX_MARGIN:g} to {MAX_MARGIN:g}")
    return margin


def moved_outline(mask: Image, margin: float) -> Image:
    """Return a mask (H, W) uint8, 0 or 255, with its outline moved outwards by a fraction of the width."""
    reach_px = margin * mask.shape[1]
    if reach_px == 0.0 or not mask.any():
        return mask
    side = np.uint8(255) - mask if reach_px > 0 else mask
    distance = cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inside = distance <= reach_px if reach_px > 0 else distance > -reach_px
    return np.asarray(inside, np.uint8) * np.uint8(255)


def frame_exposure(image: Image) -> FrameState | None:
    """Return `BLACK` or `SATURATED` for a frame that is too dark or too bright; None for other frames."""
    one, two, three = cv2.split(np.ascontiguousarray(image[::8, ::8]))
    if cv2.max(cv2.max(one, two), three).max() < BLACK_LEVEL:
        return FrameState.BLACK
    white = np.count_nonzero(cv2.min(cv2.min(one, two), three) > WHITE_LEVEL)
    return FrameState.SATURATED if white > WHITE_SHARE * one.size else None


def _large_parts(inside: Image, convex: bool) -> Image:
    """Return a mask, 0 or 255, without specks. convex: whether each part is replaced by its convex hull."""
    mask = np.zeros(inside.shape, np.uint8)
    parts, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    least = PART_SHARE * max(map(cv2.contourArea, parts), default=0.0)
    for part in parts:
        if cv2.contourArea(part) >= least:
            cv2.fillPoly(mask, [cv2.convexHull(part) if convex else part], 255)
    return mask


def contact_of(mask: Image) -> Contact:
    """Return the contact of a mask (H, W) uint8, 0 or 255; its contour is the outline of the largest part."""
    parts, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not parts:
        return NO_CONTACT
    outline = np.asarray(max(parts, key=cv2.contourArea), np.float32)
    return Contact(mask, float(cv2.countNonZero(mask)), outline)
