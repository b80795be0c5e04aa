"""Whether a contact still grows: while it does, a keyframe of it is soon out of date."""

from rig.tactile.contact.gate import Region
from rig.tactile.contact.steadiness import Steadiness

# Until a contact has settled, its keyframe is renewed when it has changed by this share.
SETTLED_FRAMES, RENEWED_SHARE = 5, 0.3


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
        """Take the next frame's contact; whether a keyframe has to be taken of it."""
        if self.settled:
            return False
        self._steadiness.update(region.levels)
        renewed = self.settled or region.changed(self._renewed, RENEWED_SHARE)
        if renewed:
            self._renewed = region
        return renewed

    def renew(self) -> None:
        """Have a keyframe taken of the next frame."""
        self._renewed = None
