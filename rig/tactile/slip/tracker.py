"""Follow one contact after another, from the first touch to the end.

No frame takes two long steps. These are: the texture of the first keyframe, its map and points, the jobs of
`rig.tactile.slip.keys`, the network, and a search.
"""

import math
from dataclasses import dataclass

from rig.tactile.settling import Settling
from rig.tactile.slip.alignment import Aligner, Fit, Pose
from rig.tactile.slip.gradient import Learn, LearntGradientMap
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.keys import Keyring
from rig.tactile.slip.parameters import MOTION
from rig.tactile.slip.search import Aligned, Search, Since
from rig.tactile.slip.seen import Seen

UNHURRIED_S = 0.045
"""Frames that are further apart leave time for all jobs of the keyframes at once."""
STEPPING_S = 0.03
"""Time after the keyframe of a settled contact in which the angle may still step: no frame is a zero."""


@dataclass(frozen=True, slots=True)
class Tracked:
    """The fit of a frame.

    worst_loss, worst_spread_rad: largest loss of agreement, and largest difference between the readings,
    since the keyframe of the settled contact; before that, since the contact began. rekeyed: whether a
    keyframe was added, or slopes and texture have changed the lead. rate_rad_s: averaged.
    """

    fit: Fit
    worst_loss: float
    worst_spread_rad: float
    rekeyed: bool
    rate_rad_s: float


class Tracker:
    """Follows one contact after another; each begins at the angle at which the last one ended."""

    def __init__(self, learn: Learn) -> None:
        self._learn, self._aligner = learn, Aligner()
        self._state: Touch | Contact | None = None
        self._refused = False

    @property
    def contact(self) -> "Contact | None":
        """The contact that is followed, None without one or before its first keyframe."""
        return self._state if isinstance(self._state, Contact) else None

    def release(self) -> None:
        """Forget the contact, because it has ended."""
        self._state, self._refused = None, False

    def follow(self, seen: Seen, angle_rad: float) -> Tracked | None:
        """Return the fit of a frame; None if the contact cannot be followed in it.

        angle_rad: where a contact that begins starts to count.
        """
        busy = False
        if self._state is None:
            if not seen.torn:
                self._state = Touch(seen, Pose(angle_rad, seen.middle_px))
            return None if self._state is None or self._refused else self._state.tracked
        if isinstance(self._state, Touch):
            self._state, busy = self._begin(self._state), True
            self._refused = self._state is None
        return None if self._state is None else self._state.follow(seen, busy)

    def _begin(self, touch: "Touch") -> "Contact | None":
        """Make the first keyframe of a contact; without a dent there is none."""
        learnt = self._learn(touch.source.difference, touch.source.mask)
        if learnt is None:
            return None
        key = make_keyframe(touch.source, learnt)
        return None if key is None else Contact(self._learn, self._aligner, touch, learnt, key)


class Touch:
    """The first frame of a contact, of which the first keyframe is made in the next frame."""

    def __init__(self, seen: Seen, pose: Pose) -> None:
        self.source, self.time_s, self.pose = seen.source(False), seen.time_s, pose
        self.settling = Settling()
        self.settling.update(seen.region.levels, seen.time_ns)

    @property
    def tracked(self) -> Tracked:
        """The fit of the frame, at the pose of the touch."""
        return Tracked(Fit(self.pose, 1.0, 1.0, 0.0, 1.0, True), 0.0, 0.0, True, 0.0)


class Contact:
    """One contact from its first keyframe on.

    anchored_px: from the point that was tracked at first to the present one. settled: whether later angles
    differ from the newest one by the measured rotation.
    """

    def __init__(
        self, learn: Learn, aligner: Aligner, touch: Touch, learnt: LearntGradientMap, key: Keyframe
    ) -> None:
        pose = Pose(touch.pose.angle_rad, key.center_px)
        self.search = Search(aligner, pose, touch.time_s)
        self.keyring = Keyring(learn, aligner, self.search.readings, learnt, key, touch.time_s)
        self._settling, self._stepped_s, self.settled = touch.settling, math.inf, False
        self._middle_px, self.anchored_px = touch.pose.point_px, 0j
        self._rate_rad_s, self._time_s = 0.0, touch.time_s
        self._worst_loss = self._worst_spread_rad = 0.0

    def follow(self, seen: Seen, busy: bool) -> Tracked | None:
        """Return the fit of a frame; None if no keyframe fits. busy: whether a keyframe was made in it."""
        search, keyring = self.search, self.keyring
        middle, before, led = seen.middle_px, search.pose, search.texture_leads
        shift_px, self._middle_px = middle - self._middle_px, middle
        added = self._work(seen.time_s - self._time_s)
        if self._settling.update(seen.region.levels, seen.time_ns):
            self._settle()
        settled, elapsed_s = self._settling.settled, seen.time_s - self._time_s
        slopes, box = keyring.slopes(seen.difference, seen.region.mask)
        since = Since(seen.time_s, elapsed_s, shift_px, settled)
        aligned = search.align(seen, slopes, box[:2], since, busy or added is not None)
        fit = aligned.fit
        if abs(fit.angle_rad - before.angle_rad) > since.reach_rad:
            return None
        rekeyed = busy or bool(added) or led != search.texture_leads
        self._accept(aligned, seen.time_s)
        if settled and keyring.is_idle:
            self._stepped_s = min(self._stepped_s, seen.time_s)
        self.settled |= seen.time_s - self._stepped_s >= STEPPING_S
        keyring.consider(seen, fit, aligned.looked, busy or added is not None, settled)
        return Tracked(fit, self._worst_loss, self._worst_spread_rad, rekeyed, self._rate_rad_s)

    def _work(self, elapsed_s: float) -> bool | None:
        """Do the job that the keyframes have left, or all if frames are far apart; see `Keyring.work`."""
        settling = self.keyring.settling
        added = self.keyring.work(self._settling.settled)
        while elapsed_s > UNHURRIED_S and self.keyring.has_work:
            added = bool(self.keyring.work(self._settling.settled)) or added
        if settling and added:
            self._worst_loss = self._worst_spread_rad = 0.0
        return added

    def _settle(self) -> None:
        """Count rotations from here, with a keyframe and one pose for all readings.

        From now on the middle of the contact is tracked: while it grew, the point may have moved along it.
        """
        self.keyring.settle()
        self.anchored_px = self._middle_px - self.search.pose.point_px
        self.search.anchor(self.anchored_px)
        self._worst_loss = self._worst_spread_rad = 0.0

    def _accept(self, aligned: Aligned, time_s: float) -> None:
        """Take the pose of a frame, and update the rate and the worst values."""
        turned_rad = aligned.fit.angle_rad - self.search.pose.angle_rad
        elapsed_s, self._time_s = time_s - self._time_s, time_s
        share = min(1.0, elapsed_s / MOTION.rate_s)
        self._rate_rad_s += share * (turned_rad / elapsed_s - self._rate_rad_s)
        self._worst_spread_rad = max(self._worst_spread_rad, self.search.accept(aligned))
        self._worst_loss = max(self._worst_loss, aligned.fit.loss)
