"""Which of several motions is believed: from several starts and keyframes, what both channels say most for.

The newest keyframe says where the contact is now. The first one of the grasp does not drift: what it says
nearby corrects the newest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rig.tactile.slip.evidence import (
    FEW_ITERATIONS,
    ITERATIONS,
    SLOPES_FIRST,
    TEXTURE_FIRST,
    TOGETHER,
    Evidence,
    Motion,
    Weighting,
)
from rig.tactile.slip.keys import MAX_JUMP_RAD, SAME_SIGMAS, ContactPose, Key
from rig.tactile.slip.loops import LEAST_MISFIT
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField

# Other starts are tried where the texture fits worse than this, or further off than was expected: aside by
# what an object turns within a frame at 10 Hz, and twice that.
GOOD_TEXTURE, SURPRISE_RAD = 0.8, math.radians(2.0)
ASIDE_RAD = tuple(math.radians(turn) for turn in (-11.4, -5.7, 5.7, 11.4))
# Slopes of the object itself leave little unexplained. Their pose stands until another has so much more
# evidence; more by the second where theirs is ample.
MORE_EVIDENCE, AMPLE_EVIDENCE, MORE_THAN_AMPLE = 0.1, 1.2, 0.5
# Where the texture leads already and correlates so well, as much will do: just after a keyframe a bulge that
# rests fits perfectly, and the degrees that it hides would be lost with the next one.
FIRM_TEXTURE = 0.95
# An older keyframe says nothing with less evidence than this; within so much, or so many standard deviations,
# it means the same motion.
LEAST_EVIDENCE, SAME_RAD = 0.15, math.radians(4.0)
# Sigma of what a channel says alone, over the root of what it leaves unexplained (the slopes': for a contact
# of contrast 1, see `Keyframe`), how ill it may correlate there, and what sigma never falls below. These
# were set on the development half of the labelled real clips, and raised after clips of
# further objects.
SLOPES_SIGMA_RAD, TEXTURE_SIGMA_RAD = math.radians(12.0), math.radians(3.0)
LEAST_CORRELATION, LEAST_SIGMA_RAD = 0.05, math.radians(0.3)
# A keyframe is kept within the first turn while there is so much evidence, beyond it while both channels
# correlate so well, and never beyond the last turn.
NEXT_KEY_RAD, KEPT_EVIDENCE = math.radians(3.0), 0.7
KEPT, FURTHEST_KEY_RAD = 0.75, math.radians(12.0)


@dataclass(frozen=True, slots=True)
class Belief:
    """A pose of the contact, the variance of its angle (rad^2), and what the key in use says for it.

    own_rad: one standard deviation of what the frame says, without its key's.
    """

    pose: ContactPose
    variance: float
    motion: Motion
    own_rad: float


class Judge:
    """Weighs the motions of one grasp, frame by frame."""

    def judged(
        self,
        keys: Sequence[Key],
        field: GradientField,
        texture: TextureField,
        expected: ContactPose,
        last: ContactPose,
        by_slopes: ContactPose | None,
        leads: bool,
    ) -> Belief | None:
        """Return where the contact is believed to be; None where the slopes' pose stands.

        keys: the grasp's first one first, its newest last. expected: where to start from. last: where it
        was. by_slopes: where its slopes alone have it if they leave little unexplained, else None. leads:
        whether the texture led in the last frame. Without texture in the newest key there is nothing to
        weigh.
        """
        newest = _witness(keys[-1], field, texture)
        if newest is None:
            return None
        alone = None if by_slopes is None else newest.motion_to(by_slopes)
        belief = self._by_newest(newest, expected, last)
        if alone is not None:
            firm = leads and belief.motion.texture >= FIRM_TEXTURE
            more = 0.0 if firm else _more_than(alone)
            if belief.motion.evidence < alone.evidence + more:
                return None
        for key in _older(keys, belief.pose.angle_rad):
            older = _witness(key, field, texture)
            if older is not None:
                belief = _together(belief, older.best(belief.pose))
        return belief

    def _by_newest(self, newest: "_Witness", expected: ContactPose, last: ContactPose) -> Belief:
        """Return what the newest key says; without evidence where an object cannot have got to."""
        found = newest.best(expected)
        off = abs(found.pose.angle_rad - expected.angle_rad)
        if found.motion.texture < GOOD_TEXTURE or off > SURPRISE_RAD:
            turned = [ContactPose(expected.angle_rad + aside, expected.point_px) for aside in ASIDE_RAD]
            others = (
                newest.tried(expected, TEXTURE_FIRST),
                newest.tried(expected, SLOPES_FIRST),
                *(newest.tried(start, TOGETHER) for start in (last, *turned)),
            )
            other = newest.best(max(others, key=lambda b: b.motion.evidence).pose)
            found = max((found, other), key=lambda b: b.motion.evidence)
        if abs(found.pose.angle_rad - last.angle_rad) > MAX_JUMP_RAD:
            return replace(found, motion=replace(found.motion, slopes=0.0, texture=0.0))
        return found


class _Witness:
    """A key that is asked about one frame."""

    def __init__(self, key: Key, evidence: Evidence) -> None:
        self._key, self._evidence = key, evidence

    def motion_to(self, pose: ContactPose) -> Motion:
        """Return what speaks for a pose."""
        return self._evidence.judged(*self._key.motion_to(pose))

    def best(self, start: ContactPose) -> Belief:
        """Return the motion found from a start."""
        return self._found(*self._key.motion_to(start), TOGETHER, ITERATIONS)

    def tried(self, start: ContactPose, weighting: Weighting) -> Belief:
        """Return roughly the motion found from a start."""
        return self._found(*self._key.motion_to(start), weighting, FEW_ITERATIONS)

    def _found(self, angle_rad: float, shift_px: complex, weighting: Weighting, iterations: int) -> Belief:
        angle_rad, shift_px = self._evidence.align(angle_rad, shift_px, weighting, iterations)
        motion = self._evidence.judged(angle_rad, shift_px)
        pose = self._key.pose_after(angle_rad, shift_px)
        own = sigma_alone(self._key, motion)
        # What rests pulls every key of a chain the same way: errors add up, not only the squares of them.
        variance = (math.sqrt(self._key.variance) + own) ** 2 + LEAST_SIGMA_RAD**2
        return Belief(pose, variance, motion, own)


def sigma_alone(key: Key, motion: Motion) -> float:
    """Return one standard deviation of a motion's angle, rad.

    A turn that changes the slopes little is told by them badly, however well they fit.
    """
    told = (
        (SLOPES_SIGMA_RAD / math.sqrt(key.frame.contrast), motion.slopes),
        (TEXTURE_SIGMA_RAD, motion.texture),
    )
    known = 0.0
    for sigma, correlation in told:
        explained = min(max(correlation, LEAST_CORRELATION) ** 2, 1.0 - LEAST_MISFIT)
        known += explained / ((1.0 - explained) * sigma**2)
    return 1.0 / math.sqrt(known)


def still_fits(motion: Motion, turned_rad: float) -> bool:
    """Return whether a keyframe still tells what texture and slopes say of a turn since it was taken."""
    if abs(turned_rad) > NEXT_KEY_RAD:
        return abs(turned_rad) <= FURTHEST_KEY_RAD and min(motion.slopes, motion.texture) >= KEPT
    return motion.evidence >= KEPT_EVIDENCE


def _more_than(motion: Motion) -> float:
    return MORE_EVIDENCE if motion.evidence < AMPLE_EVIDENCE else MORE_THAN_AMPLE


def _witness(key: Key, field: GradientField, texture: TextureField) -> _Witness | None:
    return None if key.texture is None else _Witness(key, Evidence(key.frame, key.texture, field, texture))


def _older(keys: Sequence[Key], angle_rad: float) -> list[Key]:
    """Return the first key and the oldest other one that is near, but not the newest."""
    near = [k for k in keys[1:-1] if k.near(angle_rad)]
    return [*keys[:1], *near[:1]] if len(keys) > 1 else []


def _together(belief: Belief, found: Belief) -> Belief:
    """Weigh what an older key says of the same motion into a belief."""
    gap = found.pose.angle_rad - belief.pose.angle_rad
    most = max(SAME_RAD, SAME_SIGMAS * math.sqrt(belief.variance + found.variance))
    if found.motion.evidence < LEAST_EVIDENCE or abs(gap) > most:
        return belief
    total = belief.variance + found.variance
    share = belief.variance / total
    point = belief.pose.point_px + share * (found.pose.point_px - belief.pose.point_px)
    pose = ContactPose(belief.pose.angle_rad + share * gap, point)
    return replace(belief, pose=pose, variance=belief.variance * found.variance / total)
