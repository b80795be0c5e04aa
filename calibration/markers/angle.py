"""The two-marker angle end to end, and what limits it on a bench: for calibrating and for measuring."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.planar import (
    FEWEST_FRAMES,
    PlanarAngle,
    PlaneReference,
    fit_plane,
    in_plane_angle,
)
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Corners, Refusal
from calibration.targets.edges import refine_edges
from calibration.verdict import Assessment, floor, limit
from drivers.errors import CalibrationError
from drivers.types import Image

Array = NDArray[np.floating]

EDGES_BELOW_PX = 32.0
"""From here on corners are good to 0.02 degrees at half the cost of edges."""


class Refinement(StrEnum):
    """How corners are refined: in a window around each, by the edges, or by size (the default)."""

    CORNERS = "corners"
    EDGES = "edges"
    BY_SIZE = "by size"


class MarkerAngle:
    """Measures the turn of two markers since a static reference.

    The reference is taken with edge fits, its plane is shared by all later frames; frames take the
    fast corners from 32 px on, edges below. ids, dictionary: as `MarkerTracker`.
    """

    def __init__(
        self,
        ids: tuple[int, int],
        dictionary: str = "DICT_4X4_50",
        camera: CameraModel | None = None,
        refinement: Refinement = Refinement.BY_SIZE,
    ) -> None:
        self._tracker = MarkerTracker(ids, dictionary)
        self._camera = camera
        self._refinement = refinement
        self._plane: PlaneReference | None = None
        self._zero_deg = 0.0
        self.zero_sigma_deg = 0.0

    def set_reference(self, pictures: Sequence[Image]) -> PlaneReference:
        """Take (H, W) uint8 pictures of the markers at rest as plane and zero, 10 at least, 30 better.

        Raises `CalibrationError` with what was seen when too few show both markers or they move.
        """
        quick, fine = [], []
        for picture in pictures:
            seen = self._corners(picture)
            edges = None if isinstance(seen, Refusal) else refine_edges(picture, seen)
            if edges is None or isinstance(seen, Refusal) or isinstance(edges, Refusal):
                continue
            quick.append(seen)
            fine.append(edges)
        if len(fine) < FEWEST_FRAMES:
            raise CalibrationError(
                f"markers: {len(fine)} of {len(pictures)} pictures show both, {FEWEST_FRAMES} are the least "
                f"(last refusal: {self._tracker.refusal}); check ids, dictionary, light and size"
            )
        self._plane = fit_plane(np.array(fine), self._camera)
        angles = np.array([in_plane_angle(corners, self._plane).angle_deg for corners in quick])
        self._zero_deg = float(angles.mean())
        self.zero_sigma_deg = float(angles.std(ddof=1) / np.sqrt(len(angles)))
        return self._plane

    def forget(self) -> None:
        """Search the whole next picture, as after a pause."""
        self._tracker.forget()

    def measure(self, picture: Image) -> PlanarAngle | Refusal:
        """The turn in one (H, W) uint8 picture, or why there is none.

        Raises `CalibrationError` without a reference.
        """
        if self._plane is None:
            raise CalibrationError("markers: no reference yet; take one from 10 pictures at rest")
        seen = self._corners(picture)
        if isinstance(seen, Refusal):
            return seen
        angle = in_plane_angle(seen, self._plane)
        turned = float(np.remainder(angle.angle_deg - self._zero_deg + 180.0, 360.0) - 180.0)
        return replace(angle, angle_deg=turned) if angle.in_plane else Refusal.OUT_OF_PLANE

    def _corners(self, picture: Image) -> Corners | Refusal:
        seen = self._tracker.detect(picture)
        if seen is None:
            return self._tracker.refusal or Refusal.NOT_FOUND
        small = self._refinement is Refinement.BY_SIZE and seen.side_px < EDGES_BELOW_PX
        if small or self._refinement is Refinement.EDGES:
            return refine_edges(picture, seen.corners_px)
        return seen.corners_px


@dataclass(frozen=True, slots=True, eq=False)
class MarkerReport:
    """What a still series of pictures says about the measurement.

    plane: of the reference. rest_deg: (N,) the angles at rest, deg; sigma_deg: their one sigma.
    drift_deg: change from the first to the last quarter. refused: pictures by reason.
    """

    assessment: Assessment
    plane: PlaneReference
    rest_deg: Array
    sigma_deg: float
    drift_deg: float
    refused: dict[str, int]


def assess_markers(pictures: Sequence[Image], angle: MarkerAngle) -> MarkerReport:
    """Measure how well the angle is known at rest: reference from the first half, angles of the second.

    Raises `CalibrationError` for fewer than 20 pictures or markers not seen at rest.
    """
    if len(pictures) < 2 * FEWEST_FRAMES:
        raise CalibrationError(
            f"markers: {len(pictures)} pictures at rest, {2 * FEWEST_FRAMES} are the least"
        )
    half = max(FEWEST_FRAMES, len(pictures) // 2)
    plane = angle.set_reference(pictures[:half])
    answers = [angle.measure(picture) for picture in pictures[half:]]
    rest = np.array([a.angle_deg for a in answers if not isinstance(a, Refusal)])
    refused = dict(Counter(str(a) for a in answers if isinstance(a, Refusal)))
    if len(rest) < 5:
        raise CalibrationError(
            f"markers: {len(rest)} of {len(answers)} pictures at rest give an angle ({refused})"
        )
    quarter = max(len(rest) // 4, 1)
    drift = float(rest[-quarter:].mean() - rest[:quarter].mean())
    sigma = float(rest.std(ddof=1))
    return MarkerReport(
        _assess(plane, sigma, drift, len(rest) / len(answers)), plane, rest, sigma, drift, refused
    )


def _assess(plane: PlaneReference, sigma_deg: float, drift_deg: float, answered: float) -> Assessment:
    return (
        floor(
            plane.side_px, 30.0, 16.0, "markers are {value:.0f} px wide; 40 px and more are good: move nearer"
        )
        + limit(
            sigma_deg,
            0.05,
            1.0,
            "the angle at rest scatters by {value:.3f} degrees: more light, larger markers",
        )
        + limit(abs(drift_deg), 0.05, 1.0, "the angle drifted by {value:.3f} degrees: did something move?")
        + limit(plane.tilt_deg or 0.0, 30.0, 60.0, "the markers lean by {value:.0f} degrees to the camera")
        + limit(
            plane.fit_px,
            0.3,
            1.0,
            "two equal squares fit to {value:.2f} px only: are the markers flat and equal?",
        )
        + floor(answered, 0.98, 0.5, "{value:.0%} of the pictures gave an angle")
    )
