"""Follow a contact: align each frame to keyframes in several readings; search if they fit badly.

No frame takes two long steps. These are: the texture of the first keyframe, its map and points,
each further keyframe, a map learnt again, and the change of all keyframes to it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.contact.gate import Region
from rig.tactile.settling import Settling
from rig.tactile.slip.alignment import GRID_RAD, Aligner, Fit, Pose, Reading
from rig.tactile.slip.gradient import Learn, LearntGradientMap
from rig.tactile.slip.height import Field, contact_box
from rig.tactile.slip.keyframe import Keyframe, Source, make_keyframe
from rig.tactile.slip.loops import MOST_KEYS
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES, MOST_RATE_RAD_S, MOTION
from rig.tactile.slip.slopes import slope_planes
from rig.tactile.slip.texture import Texture

FURTHER_SHARES = 0.02, 2.0
"""Weights of the slopes in the further readings: nearly texture alone, and mostly slopes."""
ASIDES = -2.0, -1.0, 1.0, 2.0
"""Further starts beside the last angle, in units of `aside_rad`."""
NEAR_TURNS, NEAR_STEPS, FAR_STEPS = 3, 4, 8
"""Steps of the search by curvature around a fit, and after a gap between frames, to either side."""
MOST_TURN_RAD, MOST_REACH_RAD = math.radians(25.0), math.pi / 2.0
"""Largest rotation between two frames that is searched: 200 degrees a second at 10 frames a second, with a
margin; and at any rate, because beyond a quarter turn many contacts resemble themselves."""
GAP_S = 0.155
"""Frames that are further apart are searched by curvature, because the motion between them is unknown."""
APART_RAD = math.radians(1.5)
"""Readings that differ by more are tried from each other's rotation; rigid contacts stay below."""
SAME_RAD, SAME_PX = math.radians(0.2), 0.1
"""Starts that are nearer to each other end at the same pose."""
BETTER = 0.02
"""Least rank that a further start must gain to be followed."""
ASTRAY_PX = 2.0
"""A contact that has shifted otherwise than the tracked point by more, in one frame, is searched."""
AFTER_LEADING = 4
"""While the texture leads, the slopes are aligned alone in every fourth frame."""
CLOSING_RAD = math.radians(5.0)
"""Starts beside the tracked angle for a direct alignment to an old keyframe."""
STEPPING_FRAMES = 2
"""Frames after the keyframe of a settled contact in which the angle may still step: none is a zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame with a contact.

    difference: (h, w, 3), relative, or slopes of `CalibratedSlopes`. texture: returns the texture, cheaply if
    the frame is busy with another long step. torn: whether parts of two images seem mixed; no keyframe is
    made of it.
    """

    difference: Field
    texture: Callable[[bool], Texture]
    region: Region
    torn: bool
    time_ns: int

    @property
    def time_s(self) -> float:
        """Time of the frame, s."""
        return self.time_ns / NS_PER_S

    def source(self, busy: bool) -> Source:
        """Return the source of a keyframe."""
        return Source(self.difference, self.region.mask, self.texture(busy))


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
                self._state = Touch(seen, Pose(angle_rad, _middle(seen.region.mask)))
            return None if self._state is None or self._refused else self._state.tracked
        if isinstance(self._state, Touch):
            self._state, busy = self._begun(self._state), True
            self._refused = self._state is None
        return None if self._state is None else self._state.follow(seen, busy)

    def _begun(self, touch: "Touch") -> "Contact | None":
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

    @property
    def tracked(self) -> Tracked:
        """The fit of the frame, at the pose of the touch."""
        return Tracked(Fit(self.pose, 1.0, 1.0, 0.0, 1.0, True), 0.0, 0.0, True, 0.0)


class Contact:
    """One contact from its first keyframe on: keyframes, readings, and the motion between the frames.

    keys: its keyframes, in the order of their frames. anchored_px: from the point that was tracked at first
    to the present one. disagrees: whether the curvature fits badly, so that a better pose is searched for.
    """

    def __init__(
        self, learn: Learn, aligner: Aligner, touch: Touch, learnt: LearntGradientMap, key: Keyframe
    ) -> None:
        self._learn, self._aligner, self._map = learn, aligner, learnt
        pose = Pose(touch.pose.angle_rad, key.center_px)
        self._readings = [Reading(share, pose) for share in (ALIGNMENT.slopes_share, *FURTHER_SHARES)]
        self._settling, self._settled_frames = Settling(), 0
        self._middle_px, self._contact_px = touch.pose.point_px, 0j
        self._rate_rad_s, self._time_s = 0.0, touch.time_s
        self._usual_score, self._checked, self._looked_s = 1.0, 0, touch.time_s
        self._weighed_s = touch.time_s
        self._texture_leads, self._led, self.disagrees = False, 0, False
        self._alone: Fit | None = None
        self._aligned: list[Reading] = []
        self._forced, self._rekeyed, self.anchored_px = False, True, 0j
        self._anew = False
        self._worst_loss = self._worst_spread_rad = 0.0
        self._pending: list[Callable[[], None]] = []
        for reading in self._readings:
            reading.keys.append(pose)
        self._take([key])

    @property
    def pose(self) -> Pose:
        """The pose in the newest frame."""
        return self._readings[0].pose

    @property
    def settled(self) -> bool:
        """Whether later angles of this contact differ from the newest one by the measured rotation."""
        return self._settled_frames > STEPPING_FRAMES

    @property
    def richest(self) -> Keyframe:
        """The keyframe with the most texture."""
        return max(self.keys, key=lambda key: key.richness)

    @property
    def observable(self) -> bool:
        """Whether a rotation changes at least one keyframe enough."""
        return any(key.observable for key in self.keys)

    def take_keyframe(self) -> None:
        """Make a keyframe of the next frame."""
        self._forced = True

    def follow(self, seen: Seen, busy: bool) -> Tracked | None:
        """Return the fit of a frame; None if no keyframe fits. busy: whether a keyframe was made in it."""
        middle = _middle(seen.region.mask)
        self._contact_px, self._middle_px = middle - self._middle_px, middle
        self._rekeyed, last_rad = busy, self.pose.angle_rad
        if self._pending:
            busy = True
            self._pending.pop(0)()
        if self._settling.update(seen.region.levels, seen.time_ns):
            self._settle()
        led = self._texture_leads
        fit, looked = self._read(seen, busy)
        self._rekeyed |= led != self._texture_leads
        if abs(fit.angle_rad - last_rad) > self._reach_rad(seen.time_s):
            return None
        self._accept(fit, seen.time_s)
        free = not self._pending
        self._settled_frames += self._settling.settled and free and not self._forced
        usable = free and not seen.torn and (looked or self._forced)
        if usable and self._wants(seen, fit, busy):
            self._forced, poses = False, [reading.pose for reading in self._readings]
            self._pending.append(partial(self._renew, seen.source(busy), poses, fit.alone))
        return self._answered(fit)

    def _answered(self, fit: Fit) -> Tracked:
        """Return the fit with the largest loss and the largest difference between the readings so far."""
        angles = [reading.pose.angle_rad for reading in self._readings]
        if self._alone is not None:
            angles.append(self._alone.angle_rad)
        self._worst_loss = max(self._worst_loss, fit.loss)
        self._worst_spread_rad = max(self._worst_spread_rad, max(angles) - min(angles))
        return Tracked(fit, self._worst_loss, self._worst_spread_rad, self._rekeyed, self._rate_rad_s)

    def _settle(self) -> None:
        """Count rotations from here, with a keyframe and one pose for all readings.

        From now on the middle of the contact is tracked: while it grew, the point may have moved along it.
        """
        self._forced, self._anew, first = True, True, self._readings[0]
        self.anchored_px = self._middle_px - first.pose.point_px
        for reading in self._readings[1:]:
            reading.join(first)
        for reading in self._readings:
            reading.anchor(self.anchored_px)
        self._worst_loss = self._worst_spread_rad = 0.0

    def _renew(self, source: Source, poses: list[Pose], alone: bool) -> None:
        """Make a keyframe of an earlier frame, with its poses in the readings; the poorest one makes room."""
        key = make_keyframe(source, self._map)
        if key is None:
            return
        outgrown = key.area_px / (KEYFRAMES.grown if key.observable else 1.0) if self._anew else 0.0
        kept = [k for k, one in enumerate(self.keys) if one.area_px > outgrown]
        if not key.observable and any(self.keys[k].observable for k in kept):
            return
        if self._settling.settled and not alone:
            poses = self._closed(source, poses)
        if self._anew:
            self._worst_loss = self._worst_spread_rad = 0.0
        self._anew = False
        self._keep(kept)
        if not self.keys or key.richness > self.richest.richness:
            self._pending.append(partial(self._learn_again, source))
        if len(self.keys) == MOST_KEYS:
            poorest = self.keys.index(min(self.keys, key=lambda one: one.richness))
            self._keep([k for k in range(MOST_KEYS) if k != poorest])
        for reading, pose in zip(self._readings, poses, strict=True):
            reading.keys.append(pose)
        self._take([*self.keys, key])
        self._rekeyed = True

    def _keep(self, kept: list[int]) -> None:
        """Forget the other keyframes."""
        self.keys = [self.keys[k] for k in kept]
        for reading in self._readings:
            reading.keys = [reading.keys[k] for k in kept]

    def _closed(self, source: Source, poses: list[Pose]) -> list[Pose]:
        """Return the poses of a frame, corrected by the oldest keyframe to which it can be aligned directly.

        The errors of a chain of keyframes add up; one step from an old keyframe does not have them.
        """
        box, first = contact_box(source.mask), poses[0]
        slopes = slope_planes(source.difference, self._map, source.mask, box, ALIGNMENT.broad_share)
        frame = slopes, box[:2], source.texture
        starts = [Pose(first.angle_rad + aside, first.point_px) for aside in (0.0, -CLOSING_RAD, CLOSING_RAD)]
        for k in range(len(self.keys)):
            fit = self._aligner.directly(k, frame, self._readings[0], starts)
            if fit.rank >= ALIGNMENT.closing_rank:
                by = fit.pose.since(first)
                far = abs(by.angle_rad) > MOST_TURN_RAD
                if far or fit.rank < self._aligner.at(first).rank + ALIGNMENT.closing_gain:
                    return poses
                for reading in self._readings:
                    reading.moved(by)
                return [pose.moved(by) for pose in poses]
        return poses

    def _learn_again(self, source: Source) -> None:
        """Learn the map at the richest keyframe; all keyframes change to it in the next frame."""
        learnt = self._learn(source.difference, source.mask)
        if learnt is not None:
            self._pending.append(partial(self._change_map, learnt))

    def _change_map(self, learnt: LearntGradientMap) -> None:
        self._map = learnt
        self._take([key.with_map(learnt) for key in self.keys])

    def _take(self, keys: list[Keyframe]) -> None:
        self.keys = keys
        self._aligner.take(keys)

    def _wants(self, seen: Seen, fit: Fit, busy: bool) -> bool:
        """Whether this frame should become a keyframe: it is asked for, has turned far, grown, or is richer.

        A contact that has grown much fits an old keyframe best when it is turned, so that its rims meet.
        """
        nearest = min(abs(key.angle_rad - fit.angle_rad) for key in self._readings[0].keys)
        if self._forced or nearest > KEYFRAMES.further_rad:
            return True
        if self._settling.settled:
            if seen.time_s - self._weighed_s < ALIGNMENT.network_s:
                return False
        elif seen.region.area_px > KEYFRAMES.grown * self.keys[-1].area_px:
            return True
        self._weighed_s = seen.time_s
        return seen.texture(busy).is_richer(KEYFRAMES.richer * self.richest.richness, seen.region.mask)

    def _reach_rad(self, time_s: float) -> float:
        """Return the largest rotation since the last frame."""
        return min(max(MOST_TURN_RAD, MOST_RATE_RAD_S * (time_s - self._time_s)), MOST_REACH_RAD)

    def _accept(self, fit: Fit, time_s: float) -> None:
        """Take the pose of a frame, and update the motion; readings that did not align move with it."""
        by = fit.pose.since(self.pose)
        elapsed_s = time_s - self._time_s
        self._rate_rad_s += min(1.0, elapsed_s / MOTION.rate_s) * (
            by.angle_rad / elapsed_s - self._rate_rad_s
        )
        self._time_s, self._readings[0].pose = time_s, fit.pose
        for reading in self._readings[1:]:
            if reading not in self._aligned:
                reading.moved(by)

    def _read(self, seen: Seen, busy: bool) -> tuple[Fit, bool]:
        """Return the fit of a frame in the first reading, and whether its texture was needed.

        If the slopes alone explain the frame, they are those of the object, and the texture is examined only
        from time to time.
        """
        mask, aligner = seen.region.mask, self._aligner
        box = contact_box(mask)
        slopes = slope_planes(seen.difference, self._map, mask, box, ALIGNMENT.broad_share)
        aligner.view(slopes, box[:2], self._readings[0])
        self._aligned: list[Reading] = []
        self._led = self._led + 1 if self._texture_leads else 0
        gap = seen.time_s - self._time_s > GAP_S
        alone = aligner.alone(self.pose) if self._led % AFTER_LEADING == 0 and not gap else None
        if alone is not None and not self._explains(alone, seen.time_s):
            alone = None
        self._alone = alone
        if alone is not None and not self._texture_leads:
            if busy or seen.time_s - self._looked_s < ALIGNMENT.look_s:
                return alone, False
        self._looked_s = seen.time_s
        texture = seen.texture(busy)
        aligner.view_texture(texture)
        joint = self._jointly(seen, gap, busy or texture.heavy)
        self._read_further(joint, seen.time_s)
        angles = [reading.pose.angle_rad for reading in self._readings]
        if gap or max(angles) - min(angles) > APART_RAD:
            joint = self._with_others(joint)
        led, self._texture_leads = self._texture_leads, True
        if alone is not None:
            aligner.read_as(self._readings[0])
            if not is_texture_better(joint.rank - aligner.at(alone.pose).rank, led):
                self._texture_leads = False
                return alone, True
        return joint, True

    def _explains(self, alone: Fit, time_s: float) -> bool:
        near = abs(alone.angle_rad - self.pose.angle_rad) < self._reach_rad(time_s)
        least = ALIGNMENT.plain_fit if self._settling.settled else ALIGNMENT.growing_fit
        return alone.best >= least and near

    def _read_further(self, joint: Fit, time_s: float) -> None:
        """Align in the other readings, from their own pose and from the first reading's rotation."""
        first = self._readings[0]
        k = self._aligner.used[0]
        turned = joint.pose.since(first.pose)
        from_key = joint.pose.since(first.keys[k])
        for reading in self._readings[1:]:
            starts = [reading.pose, reading.pose.moved(turned), reading.keys[k].moved(from_key)]
            self._aligner.read_as(reading)
            fit = self._aligner.both(_apart(starts))
            if abs(fit.angle_rad - reading.pose.angle_rad) <= self._reach_rad(time_s):
                reading.pose = fit.pose
                self._aligned.append(reading)

    def _with_others(self, joint: Fit) -> Fit:
        """Return the fit of the first reading from the rotations of the others, if its rank is higher."""
        first, k = self._readings[0], self._aligner.used[0]
        starts = [first.keys[k].moved(reading.pose.since(reading.keys[k])) for reading in self._aligned]
        if not starts:
            return joint
        self._aligner.read_as(first)
        return max(joint, self._aligner.both(starts), key=lambda fit: fit.rank)

    def _jointly(self, seen: Seen, gap: bool, busy: bool) -> Fit:
        """Align both channels, and search for a better pose after a gap or if the fit is worse than usual."""
        aligner = self._aligner
        found = aligner.both([self.pose])
        self._usual_score += 0.2 * (min(found.score, 1.5) - self._usual_score)
        self._checked += 1
        self.disagrees = found.loss >= ALIGNMENT.most_loss
        if not gap and (busy or not self._doubtful(found)):
            return found
        self._checked = 0
        best, first = aligner.coarse(self._starts(found, seen.time_s, gap))
        if best.rank < first + BETTER:
            return found
        return max(found, aligner.both([best.pose]), key=lambda fit: fit.rank)

    def _doubtful(self, found: Fit) -> bool:
        """Whether a fit is worse than usual, surprising, or has not been checked for some frames."""
        return (
            found.score < ALIGNMENT.good_score * self._usual_score
            or abs(found.angle_rad - self.pose.angle_rad) > ALIGNMENT.surprise_rad
            or abs(found.pose.point_px - self.pose.point_px - self._contact_px) > ASTRAY_PX
            or self.disagrees
            or self._checked >= ALIGNMENT.check_frames
        )

    def _starts(self, found: Fit, time_s: float, gap: bool) -> list[Pose]:
        """Return the fit, and poses from which a better one may be found."""
        angle, point = self.pose
        shifted = point + self._contact_px
        asides = (angle + aside * ALIGNMENT.aside_rad for aside in ASIDES)
        starts = [found.pose, self.pose, *(Pose(aside, point) for aside in asides), Pose(angle, shifted)]
        if self.disagrees:
            sought = self._aligner.sought(found.pose, NEAR_TURNS, NEAR_STEPS)
            if abs(sought.angle_rad - angle) < self._reach_rad(time_s):
                starts.append(sought)
        if gap:
            turns = math.ceil(self._reach_rad(time_s) / GRID_RAD)
            starts += [self._aligner.sought(Pose(angle, at), turns, FAR_STEPS) for at in (shifted, point)]
        return starts


def is_texture_better(gain: float, leads: bool) -> bool:
    """Whether the joint pose is the answer although the slopes explain the frame.

    gain: of its rank over the pose of the slopes. leads: whether it was the answer before. Because two limits
    differ, noise of the ranks does not show two poses in turn.
    """
    return gain >= (0.0 if leads else ALIGNMENT.more_score)


def _middle(mask: Image) -> complex:
    """Return the center of gravity of a mask."""
    left, top, width, height = cv2.boundingRect(mask)
    moments = cv2.moments(mask[top : top + height, left : left + width], True)
    return complex(left, top) + complex(moments["m10"], moments["m01"]) / max(moments["m00"], 1.0)


def _apart(starts: list[Pose]) -> list[Pose]:
    """Return the starts without those that lead to the same fit as an earlier one."""
    kept: list[Pose] = []
    for start in starts:
        gaps = (start.since(other) for other in kept)
        if all(abs(gap.angle_rad) > SAME_RAD or abs(gap.point_px) > SAME_PX for gap in gaps):
            kept.append(start)
    return kept
