"""Align a frame in several readings, and search for a better pose if they fit badly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from rig.tactile.slip.alignment import GRID_RAD, Aligner, Fit, Pose, Reading
from rig.tactile.slip.height import Field
from rig.tactile.slip.parameters import ALIGNMENT, MOST_RATE_RAD_S
from rig.tactile.slip.seen import Seen

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
ALONE_S = 0.065
"""While the texture leads, the slopes are aligned alone once in this time: in every fourth frame at 60 Hz."""
USUAL_S = 0.08
"""Time over which the usual score is averaged."""


@dataclass(frozen=True, slots=True)
class Since:
    """The motion since the last frame that was aligned, as far as it is known.

    time_s: time of the frame. elapsed_s: time since the last one. shift_px: of the contact. settled: whether
    the contact has settled.
    """

    time_s: float
    elapsed_s: float
    shift_px: complex
    settled: bool

    @property
    def is_gap(self) -> bool:
        """Whether the motion is unknown."""
        return self.elapsed_s > GAP_S

    @property
    def reach_rad(self) -> float:
        """The largest rotation."""
        return min(max(MOST_TURN_RAD, MOST_RATE_RAD_S * self.elapsed_s), MOST_REACH_RAD)


class Aligned(NamedTuple):
    """The alignment of a frame.

    looked: whether its texture was needed. alone: fit of the slopes alone, None if they do not explain the
    frame. further: the readings, besides the first, that have aligned it.
    """

    fit: Fit
    looked: bool
    alone: Fit | None
    further: Sequence[Reading]


class Search:
    """Aligns the frames of one contact in several readings.

    texture_leads: whether the joint alignment of the first reading is the answer, not the slopes alone.
    disagrees: whether the curvature fits badly, so that a better pose is searched for.
    """

    def __init__(self, aligner: Aligner, pose: Pose, time_s: float) -> None:
        self._aligner = aligner
        self.readings = [Reading(share, pose) for share in (ALIGNMENT.slopes_share, *FURTHER_SHARES)]
        self.texture_leads, self.disagrees = False, False
        self._usual_score = 1.0
        self._alone_s = self._checked_s = self._looked_s = time_s

    @property
    def pose(self) -> Pose:
        """The pose in the newest frame."""
        return self.readings[0].pose

    def align(
        self, seen: Seen, slopes: Field, corner_px: tuple[int, int], since: Since, busy: bool
    ) -> Aligned:
        """Align a frame with slopes (4, h, w) in a box that begins at a corner.

        If the slopes alone explain the frame, they are those of the object, and the texture is examined only
        from time to time.
        """
        aligner, first = self._aligner, self.readings[0]
        aligner.view(slopes, corner_px, first)
        is_due = not self.texture_leads or since.time_s - self._alone_s >= ALONE_S
        alone = self._alone(since) if is_due and not since.is_gap else None
        if alone is not None and not self.texture_leads:
            if busy or since.time_s - self._looked_s < ALIGNMENT.look_s:
                return Aligned(alone, False, alone, ())
        self._looked_s = since.time_s
        texture = seen.texture(busy)
        aligner.view_texture(texture)
        joint = self._joint(since, busy or texture.heavy)
        further = self._align_further(joint, since)
        if since.is_gap or self._spread_rad() > APART_RAD:
            joint = self._from_others(joint, further)
        led, self.texture_leads = self.texture_leads, True
        if alone is not None:
            aligner.read_as(first)
            if not is_texture_better(joint.rank - aligner.at(alone.pose).rank, led):
                self.texture_leads = False
                return Aligned(alone, True, alone, further)
        return Aligned(joint, True, alone, further)

    def accept(self, aligned: Aligned) -> float:
        """Take the pose of a frame; readings that did not align it move with it.

        Return the largest difference between the readings, and the slopes alone, rad.
        """
        by = aligned.fit.pose.since(self.pose)
        self.readings[0].pose = aligned.fit.pose
        for reading in self.readings[1:]:
            if reading not in aligned.further:
                reading.move(by)
        return self._spread_rad(*([] if aligned.alone is None else [aligned.alone.angle_rad]))

    def anchor(self, by_px: complex) -> None:
        """Give all readings the pose of the first, and track another point, which is away by this."""
        for reading in self.readings[1:]:
            reading.join(self.readings[0])
        for reading in self.readings:
            reading.anchor(by_px)

    def _spread_rad(self, *others_rad: float) -> float:
        angles = [*(reading.pose.angle_rad for reading in self.readings), *others_rad]
        return max(angles) - min(angles)

    def _alone(self, since: Since) -> Fit | None:
        """Return the fit of the slopes alone; None if they do not explain the frame."""
        self._alone_s = since.time_s
        alone = self._aligner.alone(self.pose)
        near = abs(alone.angle_rad - self.pose.angle_rad) < since.reach_rad
        least = ALIGNMENT.plain_fit if since.settled else ALIGNMENT.growing_fit
        return alone if alone.best >= least and near else None

    def _joint(self, since: Since, busy: bool) -> Fit:
        """Align both channels, and search for a better pose after a gap or if the fit is worse than usual."""
        aligner = self._aligner
        found = aligner.both([self.pose])
        share = 1.0 - math.exp(-since.elapsed_s / USUAL_S)
        self._usual_score += share * (min(found.score, 1.5) - self._usual_score)
        self.disagrees = found.loss >= ALIGNMENT.most_loss
        if not since.is_gap and (busy or not self._is_doubtful(found, since)):
            return found
        self._checked_s = since.time_s
        best, first = aligner.coarse(self._starts(found, since))
        if best.rank < first + BETTER:
            return found
        return max(found, aligner.both([best.pose]), key=lambda fit: fit.rank)

    def _is_doubtful(self, found: Fit, since: Since) -> bool:
        """Whether a fit is worse than usual, surprising, or was not checked for some time."""
        return (
            found.score < ALIGNMENT.good_score * self._usual_score
            or abs(found.angle_rad - self.pose.angle_rad) > ALIGNMENT.surprise_rad
            or abs(found.pose.point_px - self.pose.point_px - since.shift_px) > ASTRAY_PX
            or self.disagrees
            or since.time_s - self._checked_s >= ALIGNMENT.check_s
        )

    def _starts(self, found: Fit, since: Since) -> list[Pose]:
        """Return the fit, and poses from which a better one may be found."""
        angle, point = self.pose
        shifted = point + since.shift_px
        asides = (angle + aside * ALIGNMENT.aside_rad for aside in ASIDES)
        starts = [found.pose, self.pose, *(Pose(aside, point) for aside in asides), Pose(angle, shifted)]
        if self.disagrees:
            sought = self._aligner.search_grid(found.pose, NEAR_TURNS, NEAR_STEPS)
            if abs(sought.angle_rad - angle) < since.reach_rad:
                starts.append(sought)
        if since.is_gap:
            turns = math.ceil(since.reach_rad / GRID_RAD)
            starts += [
                self._aligner.search_grid(Pose(angle, at), turns, FAR_STEPS) for at in (shifted, point)
            ]
        return starts

    def _align_further(self, joint: Fit, since: Since) -> list[Reading]:
        """Align in the other readings, from their own pose and from the first reading's rotation.

        Return those that have found a pose.
        """
        first, further = self.readings[0], list[Reading]()
        k = self._aligner.used[0]
        turned, from_key = joint.pose.since(first.pose), joint.pose.since(first.keys[k])
        for reading in self.readings[1:]:
            starts = [reading.pose, reading.pose.moved(turned), reading.keys[k].moved(from_key)]
            self._aligner.read_as(reading)
            fit = self._aligner.both(_apart(starts))
            if abs(fit.angle_rad - reading.pose.angle_rad) <= since.reach_rad:
                reading.pose = fit.pose
                further.append(reading)
        return further

    def _from_others(self, joint: Fit, further: Sequence[Reading]) -> Fit:
        """Return the fit of the first reading from the rotations of the others, if its rank is higher."""
        first, k = self.readings[0], self._aligner.used[0]
        starts = [first.keys[k].moved(reading.pose.since(reading.keys[k])) for reading in further]
        if not starts:
            return joint
        self._aligner.read_as(first)
        return max(joint, self._aligner.both(starts), key=lambda fit: fit.rank)


def is_texture_better(gain: float, leads: bool) -> bool:
    """Whether the joint pose is the answer although the slopes explain the frame.

    gain: of its rank over the pose of the slopes. leads: whether it was the answer before. Because two limits
    differ, noise of the ranks does not show two poses in turn.
    """
    return gain >= (0.0 if leads else ALIGNMENT.more_score)


def _apart(starts: list[Pose]) -> list[Pose]:
    """Return the starts without those that lead to the same fit as an earlier one."""
    kept: list[Pose] = []
    for start in starts:
        gaps = (start.since(other) for other in kept)
        if all(abs(gap.angle_rad) > SAME_RAD or abs(gap.point_px) > SAME_PX for gap in gaps):
            kept.append(start)
    return kept
