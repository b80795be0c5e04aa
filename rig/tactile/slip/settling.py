"""What a contact's region says of a frame: whether it still grows, and whether it is to be believed."""

from rig.tactile.contact.gate import Region
from rig.tactile.contact.steadiness import Steadiness

# Until a contact has settled, its keyframe is out of date when the contact has changed by this share.
SETTLED_FRAMES, RENEWED_SHARE = 5, 0.3
# An area that jumps by half, up or down, from one frame to the next is no growth: a frame is torn, or a
# video's codec has begun anew.
TORN_RATIO = 1.5


class Settling:
    """Follows one contact from its first touch on."""

    def __init__(self) -> None:
        self._steadiness = Steadiness(SETTLED_FRAMES)
        self._renewed: Region | None = None

    @property
    def settled(self) -> bool:
        """Whether the contact no longer grows."""
        return self._steadiness.settled

    def update(self, region: Region) -> bool:
        """Take the next frame's contact; whether it has settled with this very frame."""
        if self.settled:
            return False
        self._steadiness.update(region.levels)
        return self.settled

    def outgrown(self, region: Region) -> bool:
        """Whether an unsettled contact is another than when its keyframe was taken."""
        return not self.settled and region.changed(self._renewed, RENEWED_SHARE)

    def renewed(self, region: Region) -> None:
        """Note that a keyframe was taken of this contact."""
        self._renewed = region


class Tearing:
    """Tells frames of which no keyframe should be taken, by the contact's area."""

    def __init__(self) -> None:
        self._area_px: int | None = None

    def update(self, region: Region | None) -> bool:
        """Take the next frame's contact; whether its area is another than a frame before."""
        before, self._area_px = self._area_px, None if region is None else region.area_px
        if before is None or region is None:
            return False
        return max(before, region.area_px) > TORN_RATIO * min(before, region.area_px)
