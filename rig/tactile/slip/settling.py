"""Whether a contact still grows, and whether a frame is torn, by the contact's region."""

from drivers.clock import to_ns
from rig.tactile.contact.gate import Region, Steadiness

# Number of frames and time without growth after which a contact has settled: fingers that close step by
# step rest for a tenth of a second between two steps, and a keyframe of a light touch fits no firm grip.
SETTLED_FRAMES, SETTLED_S = 5, 0.15
# Until then its keyframe is out of date when the contact has changed by this share.
RENEWED_SHARE = 0.3
# An area that jumps by half, up or down, from one frame to the next is no growth: a frame is torn, or a
# video's codec has restarted.
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
        """Take the next frame's contact; whether it has settled with this very frame."""
        if self.settled:
            return False
        if self._steadiness.update(region.levels):
            self._steady_ns = time_ns
        long_enough = time_ns - self._steady_ns >= to_ns(SETTLED_S)
        self.settled = self._steadiness.settled and long_enough
        return self.settled

    def outgrown(self, region: Region) -> bool:
        """Whether an unsettled contact is another than when its keyframe was taken."""
        return not self.settled and region.changed(self._renewed, RENEWED_SHARE)

    def renewed(self, region: Region) -> None:
        """Note that a keyframe was taken of this contact."""
        self._renewed = region


class Tearing:
    """Detects torn frames by the area of the contact; no keyframe is taken of them."""

    def __init__(self) -> None:
        self._area_px: int | None = None

    def update(self, region: Region | None) -> bool:
        """Take the next frame's contact; whether its area is another than a frame before."""
        before, self._area_px = self._area_px, None if region is None else region.area_px
        if before is None or region is None:
            return False
        return max(before, region.area_px) > TORN_RATIO * min(before, region.area_px)
