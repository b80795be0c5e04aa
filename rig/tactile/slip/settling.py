"""Decide whether a contact still grows, and whether a frame is torn, from the region of the contact."""

from drivers.clock import to_ns
from rig.tactile.contact.gate import Region, Steadiness
from rig.tactile.slip.parameters import KEYFRAMES

# Number of frames without growth after which a contact may have settled.
SETTLED_FRAMES = 5


class Settling:
    """Follows one contact from its first touch on."""

    def __init__(self) -> None:
        self.settled = False
        """Whether the contact no longer grows."""
        self._steadiness = Steadiness(SETTLED_FRAMES)
        self._steady_ns: int | None = None
        self._renewed: Region | None = None

    def update(self, region: Region, time_ns: int) -> bool:
        """Update with the contact of the next frame; return whether it has settled in this frame."""
        if self.settled:
            return False
        if self._steadiness.update(region.levels):
            self._steady_ns = time_ns
        steady_ns = self._steady_ns
        long_enough = steady_ns is None or time_ns - steady_ns >= to_ns(KEYFRAMES.settled_s)
        self.settled = self._steadiness.settled and long_enough
        return self.settled

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
