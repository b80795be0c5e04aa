"""A frame with a contact, as the tracker sees it."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2

from drivers.clock import NS_PER_S
from rig.tactile.contact.gate import Region
from rig.tactile.slip.height import Field
from rig.tactile.slip.keyframe import Source
from rig.tactile.slip.texture import Texture


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame with a contact.

    difference: (h, w, 3), relative, or slopes of `CalibratedSlopes`. texture: returns the texture, cheaply if
    the frame is busy with another long step. torn: whether parts of two images seem mixed; no keyframe is
    made of it.
    """

    difference: Field
    texture: Callable[[bool], Texture]
    region: Region
    torn: bool
    time_ns: int

    @property
    def time_s(self) -> float:
        """Time of the frame, s."""
        return self.time_ns / NS_PER_S

    @property
    def middle_px(self) -> complex:
        """The center of gravity of the contact, work pixels."""
        left, top, width, height = cv2.boundingRect(self.region.mask)
        moments = cv2.moments(self.region.mask[top : top + height, left : left + width], True)
        moment = complex(moments["m10"], moments["m01"])
        return complex(left, top) + moment / max(moments["m00"], 1.0)

    def source(self, busy: bool) -> Source:
        """Return the source of a keyframe."""
        return Source(self.difference, self.region.mask, self.texture(busy))
