"""Whether a contact still grows: while it does, a keyframe of it is soon out of date."""

from rig.tactile.contact.gate import Region

# A contact is settled when strength and area have stayed within this share for so many frames; until
# then the keyframe is renewed when it has changed by the larger share.
SETTLED_SHARE, SETTLED_FRAMES, RENEWED_SHARE = 0.05, 5, 0.3


class Settling:
    """Follows one contact from its first touch on."""

    def __init__(self) -> None:
        self.settled = False
        self._steady = 0
        self._level: Region | None = None
        self._renewed: Region | None = None

    def update(self, region: Region) -> bool:
        """Take the next frame's contact; whether a keyframe has to be taken of it."""
        if self.settled:
            return False
        if region.changed(self._level, SETTLED_SHARE):
            self._level, self._steady = region, 0
        self._steady += 1
        self.settled = self._steady >= SETTLED_FRAMES
        renewed = self.settled or region.changed(self._renewed, RENEWED_SHARE)
        if renewed:
            self._renewed = region
        return renewed

    def renew(self) -> None:
        """Have a keyframe taken of the next frame."""
        self._renewed = None
