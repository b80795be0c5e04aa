"""Estimate the rotation of a gel with markers under a contact, after Kolamuri et al. (see `rotation_centre`).

The contact is detected on frames whose markers are removed. The markers inside it are tracked from the
contact's first stable frame on. Their displacements give centre and angle of the rotation. The method
measures the rotation of the gel: if the object slides on the gel, the angle is too small.
"""

import math

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.dots import without_markers
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.contact.relative import full_area
from rig.tactile.contact.steadiness import Steadiness
from rig.tactile.peers.dots import DotTracker
from rig.tactile.peers.rotation_centre import Degenerate, Rotation, find_rotation
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, check_frame
from rig.tactile.stopwatch import Stopwatch

# The reference is replaced until the area has stayed within SETTLED_SHARE for this number of frames.
SETTLED_FRAMES = 6
# Larger frames are reduced to this long side: this is many times faster, and the dots are found as
# accurately.
MOST_PX = 1024
# After a loss of contact for longer than this, a contact is a new grasp.
FORGET_S = 0.5


class KolamuriEstimator(FreshFrameEstimator):
    """Centre and angle of rotation by least squares from the markers in the contact.

    background: (H, W, 3) uint8 RGB, a frame without contact. States: `no_contact`; `unobservable` if the
    markers have no centre of rotation (`refusal` has the reason); `rekeyed` at a new reference after a first
    angle; else `tracking`. If the markers have not moved, the last angle is reported. It has no sigma.
    """

    stages = ("contact", "markers", "rotation")

    def __init__(self, background: Image) -> None:
        check_frame(background)
        super().__init__(background.shape)
        self._size = _work_size(background)
        self._finder = ContactFinder(without_markers(self._reduced(background)))
        self._seen_ns: int | None = None
        self._zero_rad = self._angle_rad = 0.0
        self._tracker: DotTracker | None = None
        self._inside = np.zeros(0, bool)
        self._answered = False
        self.refusal: Degenerate | None = None
        self._release()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch, full = Stopwatch(), image.shape
        image = self._reduced(image)
        contact = self._finder.find(without_markers(image))
        watch.lap("contact")
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        if self._seen_ns is not None and time_ns - self._seen_ns > FORGET_S * NS_PER_S:
            self._release()
        self._seen_ns = time_ns
        rekeyed = self._settle(image, contact)
        state, angle_deg = self._answer(image, contact.mask, rekeyed, watch)
        area = full_area(contact.area_px, image.shape, full)
        return SlipSample(time_ns, state, angle_deg, contact_area_px=area, stage_s=watch.stage_s)

    def _reduced(self, image: Image) -> Image:
        if self._size == image.shape[1::-1]:
            return image
        return np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8)

    def _answer(
        self, image: Image, mask: Image, rekeyed: bool, watch: Stopwatch
    ) -> tuple[State, float | None]:
        found = self._rotation(image, mask, watch)
        self.refusal = found if isinstance(found, Degenerate) else None
        if isinstance(found, Rotation):
            turns = round((self._angle_rad - found.angle_rad) / (2 * math.pi))
            self._angle_rad = found.angle_rad + turns * 2 * math.pi
        elif found is not Degenerate.STILL:
            return State.UNOBSERVABLE, None
        state = State.REKEYED if rekeyed and self._answered else State.TRACKING
        self._answered = True
        return state, math.degrees(self._zero_rad + self._angle_rad)

    def _rotation(self, image: Image, mask: Image, watch: Stopwatch) -> Rotation | Degenerate:
        """Return the rotation, since the reference, of the markers that were inside the contact then."""
        if self._tracker is None:
            self._tracker = DotTracker(image)
            columns, rows = np.rint(self._tracker.first_px).astype(int).T
            self._inside = mask[rows, columns] > 0
        motion = self._tracker.update(image)
        watch.lap("markers")
        used = motion.seen & self._inside
        found = find_rotation(motion.first_px[used], motion.now_px[used])
        watch.lap("rotation")
        return found

    def _settle(self, image: Image, contact: Contact) -> bool:
        """Track the growth of a contact; return whether this frame becomes the reference."""
        if self._steadiness.settled:
            return False
        if self._steadiness.update((contact.area_px,)) or self._steadiness.settled:
            self._rebase()
            return True
        return False

    def _rebase(self) -> None:
        """Drop the reference, and continue from the current angle."""
        self._zero_rad += self._angle_rad
        self._angle_rad, self._tracker = 0.0, None

    def _release(self) -> None:
        self._rebase()
        self._steadiness = Steadiness(SETTLED_FRAMES, drifting=True)


def _work_size(image: Image) -> tuple[int, int]:
    """Return width and height in px to which frames are reduced, at most their own."""
    share = min(1.0, MOST_PX / max(image.shape[:2]))
    width, height = (max(8, round(side * share)) for side in image.shape[1::-1])
    return width, height
