"""Decide whether a contact still grows, and whether a frame is torn, from the region of the contact."""

from rig.tactile.contact.gate import Region
from rig.tactile.settling import Settling
from rig.tactile.slip.parameters import KEYFRAMES


class Growth(Settling):
    """Follows the growth of one contact from its first touch on."""

    def __init__(self) -> None:
        super().__init__()
        self._renewed: Region | None = None

    def outgrown(self, region: Region) -> bool:
        """Whether an unsettled contact has changed by the fraction `renewed_share` since its keyframe."""
        return not self.settled and region.changed(self._renewed, KEYFRAMES.renewed_share)

    def renewed(self, region: Region) -> None:
        """Store the region of the contact at a new keyframe."""
        self._renewed = region


class Tearing:
    """Detects torn frames by the area of the contact; no keyframe is taken of them."""

    def __init__(self) -> None:
        self._area_px: int | None = None

    def update(self, region: Region | None) -> bool:
        """Update with the contact of the next frame; return whether its area has jumped."""
        before, self._area_px = self._area_px, None if region is None else region.area_px
        if before is None or region is None:
            return False
        return max(before, region.area_px) > KEYFRAMES.torn_ratio * min(before, region.area_px)
