"""Detect torn frames, in which parts of two images are mixed, from the region of the contact."""

from rig.tactile.contact.gate import Region
from rig.tactile.slip.parameters import KEYFRAMES


class Tearing:
    """Detects torn frames by the area of the contact; no keyframe is made of them."""

    def __init__(self) -> None:
        self._area_px: int | None = None

    def update(self, region: Region | None) -> bool:
        """Update with the contact of the next frame; return whether its area has jumped."""
        before, self._area_px = self._area_px, None if region is None else region.area_px
        if before is None or region is None:
            return False
        return max(before, region.area_px) > KEYFRAMES.torn_ratio * min(before, region.area_px)
