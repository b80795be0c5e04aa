"""Estimate the rotation of a gel with markers under a contact, after Kolamuri et al. 2021.

Kolamuri, Si, Zhang, Agarwal and Yuan, "Improving grasp stability with rotation measurement from tactile
sensing" (IROS 2021, arXiv:2108.00301). In a rotation every point moves at right angles to its ray from the
centre. Therefore the perpendicular bisectors of all displacements meet in the centre, also for large
rotations. With the centre known, the angle is the only unknown.

The contact is detected on frames whose markers are removed. The markers inside it are tracked from the
contact's first stable frame on. Their displacements give centre and angle of the rotation. The method
measures the rotation of the gel: if the object slides on the gel, the angle is too small.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.dots import Points, find_dots, without_markers
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.contact.relative import full_area
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, Stopwatch, check_frame
from rig.tactile.settling import NEW_GRASP_NS, REFERENCE_S, Settling

# Search radius of a marker as a fraction of the distance to its nearest neighbour.
STEP_SHARE = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class MarkerMotion:
    """Positions (N, 2) of the markers in the first and in this frame, px; seen: (N,), found in this frame."""

    first_px: Points
    now_px: Points
    seen: NDArray[np.bool_]


class DotTracker:
    """Tracks the markers of a first frame from frame to frame.

    A marker that is lost can be found again near its last position. image: first frame, (H, W, 3) uint8 RGB.
    Raises `InputError` for another shape or type.
    """

    def __init__(self, image: Image) -> None:
        self._first = find_dots(image)
        self._now = self._first.copy()
        self._step = _steps(self._first)

    @property
    def first_px(self) -> Points:
        """The markers (N, 2) of the first frame."""
        return self._first

    def update(self, image: Image) -> MarkerMotion:
        """Find the markers in the next frame, (H, W, 3) uint8 RGB. Raises `InputError`."""
        found = find_dots(image)
        seen = np.zeros(len(self._now), bool)
        if len(found) and len(self._now):
            far, nearest = map(np.asarray, KDTree(found).query(self._now))
            back = np.asarray(KDTree(self._now).query(found)[1])
            # Mutual nearest neighbours only, so that two markers are never matched to the same spot.
            seen = (far <= self._step) & (back[nearest] == np.arange(len(self._now)))
            self._now[seen] = found[nearest[seen]]
        return MarkerMotion(self._first, self._now.copy(), seen)


def _steps(points: Points) -> NDArray[np.float64]:
    """Return the largest distance that each marker may move between two frames, px."""
    if len(points) < 2:
        return np.zeros(len(points))
    return STEP_SHARE * np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]


MIN_POINTS = 3
# Smallest rms displacement that has a direction: positions of markers are accurate to 0.1 to 0.2 px.
NOISE_PX = 0.15
# Points count as collinear if their spread across a line is below this fraction of the spread along it. If
# the centre is on that line, the perpendicular bisectors of their displacements coincide.
LEAST_SPREAD = 0.1

Points = NDArray[np.float64]


class Degenerate(StrEnum):
    """Reason why displacements have no centre of rotation."""

    TOO_FEW = "fewer than 3 points were found before and after"
    COLLINEAR = "the points are on one line"
    STILL = "the points have not moved"
    TRANSLATION = "all points moved in the same way: a translation without rotation"


@dataclass(frozen=True, slots=True)
class Rotation:
    """A rotation. centre_px: (x, y), x to the right, y down. angle_rad: counter-clockwise positive."""

    centre_px: tuple[float, float]
    angle_rad: float


def find_rotation(before_px: Points, after_px: Points) -> Rotation | Degenerate:
    """Return the rotation between two sets of points, or the reason why there is none.

    before_px, after_px: (N, 2), x to the right, y down. The angle is within +-pi. Raises `InputError` for
    different shapes, or for NaN or infinite values.
    """
    before, after = np.asarray(before_px, np.float64), np.asarray(after_px, np.float64)
    _check(before, after)
    if len(before) < MIN_POINTS:
        return Degenerate.TOO_FEW
    along, across = np.linalg.svd(before - before.mean(axis=0), compute_uv=False)
    if across <= LEAST_SPREAD * along:
        return Degenerate.COLLINEAR
    moved = after - before
    if _rms(moved) < NOISE_PX:
        return Degenerate.STILL
    if _rms(moved - moved.mean(axis=0)) < NOISE_PX:
        return Degenerate.TRANSLATION
    centre = _centre(0.5 * (before + after), moved)
    return Rotation((float(centre[0]), float(centre[1])), turn_about(before - centre, after - centre))


def turn_about(before: Points, after: Points) -> float:
    """Return the least-squares angle between rays (N, 2) from the centre, rad, counter-clockwise positive."""
    across = (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum()
    return -math.atan2(float(across), float((before * after).sum()))


def _centre(middles: Points, moved: Points) -> Points:
    """Return the point nearest to all normals: moved . (centre - middle) = 0 for each point."""
    origin = middles.mean(axis=0)
    offsets = (moved * (middles - origin)).sum(axis=1)
    return origin + np.linalg.lstsq(moved, offsets, rcond=None)[0]


def _rms(vectors: Points) -> float:
    return math.sqrt(float(np.square(vectors).sum(axis=1).mean()))


def _check(before: Points, after: Points) -> None:
    if before.ndim != 2 or before.shape[1:] != (2,) or before.shape != after.shape:
        raise InputError(f"points have the shapes {before.shape} and {after.shape}: both have to be (N, 2)")
    if not (np.isfinite(before).all() and np.isfinite(after).all()):
        raise InputError("points have values that are not finite: leave out points that were not found")


# Larger frames are reduced to this long side: this is many times faster, and the dots are found as
# accurately.
MOST_PX = 1024


class KolamuriEstimator(FreshFrameEstimator):
    """Centre and angle of rotation by least squares from the markers in the contact.

    background: (H, W, 3) uint8 RGB, a frame without contact. States: `no_contact`; `unobservable` if the
    markers have no centre of rotation (`refusal` has the reason); `rekeyed` at a new reference after a first
    angle; else `tracking`. If the markers have not moved, the last angle is reported. It has no sigma.
    """

    follows_motion = True
    stages = ("contact", "markers", "rotation")

    def __init__(self, background: Image) -> None:
        check_frame(background)
        super().__init__(background.shape)
        self._size = _work_size(background)
        self._finder = ContactFinder(without_markers(self._reduce(background)))
        self._seen_ns: int | None = None
        self._zero_rad = self._angle_rad = 0.0
        self._tracker: DotTracker | None = None
        self._inside = np.zeros(0, bool)
        self._answered = False
        self.refusal: Degenerate | None = None
        self._release()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch, full = Stopwatch(), image.shape
        image = self._reduce(image)
        contact = self._finder.find(without_markers(image))
        watch.lap("contact")
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        if self._seen_ns is not None and time_ns - self._seen_ns > NEW_GRASP_NS:
            self._release()
        self._seen_ns = time_ns
        rekeyed = self._settle(contact, time_ns)
        state, angle_deg = self._answer(image, contact.mask, rekeyed, watch)
        area = full_area(contact.area_px, image.shape, full)
        return SlipSample(time_ns, state, angle_deg, contact_area_px=area, stage_s=watch.stage_s)

    def _reduce(self, image: Image) -> Image:
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

    def _settle(self, contact: Contact, time_ns: int) -> bool:
        """Track the growth of a contact; return whether this frame becomes the reference."""
        if not self._growth.update((contact.area_px,), time_ns) and not self._growth.changed:
            return False
        self._rebase()
        return True

    def _rebase(self) -> None:
        """Drop the reference, and continue from the current angle."""
        self._zero_rad += self._angle_rad
        self._angle_rad, self._tracker = 0.0, None

    def _release(self) -> None:
        self._rebase()
        self._growth = Settling(REFERENCE_S, drifting=True)


def _work_size(image: Image) -> tuple[int, int]:
    """Return width and height in px to which frames are reduced, at most their own."""
    share = min(1.0, MOST_PX / max(image.shape[:2]))
    width, height = (max(8, round(side * share)) for side in image.shape[1::-1])
    return width, height
