"""A standard method of image alignment as an estimator, for comparison: `ecc`.

It aligns each frame with the contact's first stable frame. It uses the magnitude of the relative difference
from the background, on a reduced copy, because it turns with the object; the colours do not. The alignment is
OpenCV's maximisation of the enhanced correlation coefficient over rotation and translation (Evangelidis and
Psarakis, IEEE TPAMI 30 (10), 2008).
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.contact.relative import RelativeDifference, full_area, work_size
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, Stopwatch
from rig.tactile.settling import NEW_GRASP_NS, REFERENCE_S, Settling

NOISE_BLUR_PX = 1.0
# Smallest rotational contrast of a reference (see `_contrast`). Below this the contact is round and its
# rotation unobservable: SIMULATED smooth balls reach 0.1, cans at least 0.3.
LEAST_CONTRAST = 0.15
# Stopping criteria of cv2.findTransformECC.
ECC_ITERATIONS, ECC_STEP = 30, 1e-5
# Lowest correlation that is accepted.
LEAST_CORRELATION = 0.6
# Initial angles of the alignment relative to the last angle, tried in this order.
SEARCH_RAD = tuple(math.radians(turn) for turn in (0, -20, 20, -40, 40))

Energy = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """The alignment of a frame with the reference.

    angle_rad: counter-clockwise positive. shift_px: (2,), of the contact's centre in work pixels.
    """

    angle_rad: float
    shift_px: NDArray[np.float64]


class EccMatcher:
    """OpenCV's ECC for a rotation and a translation. reference: (h, w) float32. mask: (h, w) uint8."""

    def __init__(self, reference: Energy, mask: Image) -> None:
        self._reference = reference
        self._everywhere = np.full(reference.shape, 255, np.uint8)
        self._center = _middle(mask)

    def match(self, energy: Energy, last: Match) -> Match | None:
        """Return the match of a frame, searched near the last match; None if there is none."""
        for turn in SEARCH_RAD:
            found = self._from(energy, last.angle_rad + turn, last.shift_px)
            if found is not None:
                turns = round((last.angle_rad - found.angle_rad) / (2 * math.pi))
                return replace(found, angle_rad=found.angle_rad + turns * 2 * math.pi)
        return None

    def _from(self, energy: Energy, angle_rad: float, shift_px: NDArray[np.float64]) -> Match | None:
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        turn = np.array([[cos, sin], [-sin, cos]])
        move = self._center + shift_px - turn @ self._center
        warp = np.column_stack([turn, move]).astype(np.float32)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ECC_ITERATIONS, ECC_STEP)
        try:
            correlation, warp = cv2.findTransformECC(
                self._reference, energy, warp, cv2.MOTION_EUCLIDEAN, criteria, self._everywhere, 1
            )
        except cv2.error:  # OpenCV raises if the iteration does not converge
            return None
        if not (correlation >= LEAST_CORRELATION and np.isfinite(warp).all()):
            return None
        middle = warp[:, :2].astype(np.float64) @ self._center + warp[:, 2]
        return Match(math.atan2(float(warp[0, 1]), float(warp[0, 0])), middle - self._center)


class EccEstimator(FreshFrameEstimator):
    """Aligns each frame with the contact's first stable frame.

    background: (H, W, 3) uint8 RGB, a frame without contact.
    States: `no_contact`; `unobservable` if the reference is round; `lost` if no alignment is found; `rekeyed`
    at a new reference after a first angle; else `tracking`. It has no sigma.
    """

    follows_motion = True
    stages = ("contact", "alignment")

    def __init__(self, background: Image) -> None:
        super().__init__(background.shape)
        size = work_size(background.shape, 1.0)
        self._px_per_work = background.shape[0] / size[1]
        self._light = RelativeDifference(background, size)
        self._seen_ns: int | None = None
        self._answered = False
        self._zero_rad = 0.0
        self._release()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        difference = self._light.of(self._light.reduce(image))
        difference = np.asarray(cv2.GaussianBlur(difference, (0, 0), NOISE_BLUR_PX), np.float32)
        region = find_contact(difference)
        watch.lap("contact")
        if region is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=self.stages[1:])
        if self._seen_ns is not None and time_ns - self._seen_ns > NEW_GRASP_NS:
            self._zero_rad += self._match.angle_rad
            self._release()
        self._seen_ns = time_ns
        state = self._follow(_magnitude(difference), region, time_ns)
        watch.lap("alignment")
        return self._answer(time_ns, state, region, watch)

    def _follow(self, energy: Energy, region: Region, time_ns: int) -> State:
        if self._matcher is not None:
            found = self._matcher.match(energy, self._match)
            self._match = found or self._match
            if found is None and self._growth.settled:
                return State.LOST
        elif self._growth.settled:
            return State.UNOBSERVABLE
        if self._growth.update(region.levels, time_ns) or self._growth.changed:
            self._rebase(energy, region)
            return State.UNOBSERVABLE if self._matcher is None else State.REKEYED
        return State.UNOBSERVABLE if self._matcher is None else State.TRACKING

    def _answer(self, time_ns: int, state: State, region: Region, watch: Stopwatch) -> SlipSample:
        area = full_area(region.area_px, region.mask.shape, self._shape or region.mask.shape)
        if state in (State.UNOBSERVABLE, State.LOST):
            return SlipSample(time_ns, state, contact_area_px=area, stage_s=watch.stage_s)
        if not self._answered:
            self._answered, state = True, State.TRACKING
        shift = self._match.shift_px * self._px_per_work
        return SlipSample(
            time_ns,
            state,
            math.degrees(self._zero_rad + self._match.angle_rad),
            shift_px=(float(shift[0]), float(shift[1])),
            contact_area_px=area,
            stage_s=watch.stage_s,
        )

    def _rebase(self, energy: Energy, region: Region) -> None:
        """Make this frame the reference, at its estimated angle."""
        self._zero_rad += self._match.angle_rad
        self._match = Match(0.0, np.zeros(2))
        observable = _contrast(energy, region.mask) >= LEAST_CONTRAST
        self._matcher = EccMatcher(energy, region.mask) if observable else None

    def _release(self) -> None:
        self._match = Match(0.0, np.zeros(2))
        self._matcher: EccMatcher | None = None
        self._growth = Settling(REFERENCE_S, drifting=True)


def _magnitude(difference: NDArray[np.float32]) -> Energy:
    squares = cv2.transform(cv2.multiply(difference, difference), np.ones((1, 3), np.float32))
    return np.asarray(cv2.sqrt(squares), np.float32)


def _middle(mask: Image) -> NDArray[np.float64]:
    moments = cv2.moments(mask, True)
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


def _contrast(energy: Energy, mask: Image) -> float:
    """Return the rotational contrast of a reference: how much a rotation changes it, 0 if not at all.

    It is the squared change of the image per rad of rotation, divided by the squared image. The part of the
    change that a translation would also cause is removed.
    """
    smooth = cv2.GaussianBlur(energy, (0, 0), 1.5)
    rows, columns = np.nonzero(mask)
    x, y = _middle(mask)
    along_x = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32)[rows, columns].astype(np.float64)
    along_y = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32)[rows, columns].astype(np.float64)
    turn = along_x * (rows - y) - along_y * (columns - x)
    shifts = np.stack([along_x, along_y], axis=1)
    imitated = shifts @ np.linalg.lstsq(shifts, turn, rcond=None)[0]
    total = float(np.square(smooth[rows, columns]).sum())
    return float(np.square(turn - imitated).sum()) / total if total > 0.0 else 0.0
