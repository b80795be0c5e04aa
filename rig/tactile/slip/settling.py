"""Decide whether a contact still grows, and whether a frame is torn, from the region of the contact."""

from drivers.clock import to_ns
from rig.tactile.contact.gate import Region, Steadiness

# Number of frames and time without growth after which a contact has settled. Fingers that close step by step
# are at rest for a tenth of a second between two steps, and a keyframe of a light touch does not fit a firm
# grip.
SETTLED_FRAMES, SETTLED_S = 5, 0.15
# Until then its keyframe is replaced when the contact has changed by this fraction.
RENEWED_SHARE = 0.3
# Ratio of the areas in two consecutive frames from which on a frame is torn, or a video codec has restarted.
TORN_RATIO = 1.5


class Settling:
    """Follows one contact from its first touch on."""

    def __init__(self) -> None:
        self.settled = False
        """Whether the contact no longer grows."""
        self._steadiness = Steadiness(SETTLED_FRAMES)
        self._steady_ns = 0
        self._renewed: Region | None = None

    def update(self, region: Region, time_ns: int) -> bool:
        """Update with the contact of the next frame; return whether it has settled in this frame."""
        if self.settled:
            return False
        if self._steadiness.update(region.levels):
            self._steady_ns = time_ns
        long_enough = time_ns - self._steady_ns >= to_ns(SETTLED_S)
        self.settled = self._steadiness.settled and long_enough
        return self.settled

    def outgrown(self, region: Region) -> bool:
        """Whether an unsettled contact has changed by `RENEWED_SHARE` since its keyframe."""
        return not self.settled and region.changed(self._renewed, RENEWED_SHARE)

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
        return max(before, region.area_px) > TORN_RATIO * min(before, region.area_px)
