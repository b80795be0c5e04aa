"""Measure the rotation of two markers since a reference at rest, from picture to degrees.

This is the only marker measurement: it gives the ground truth of lifts, and `rig calibrate markers` measures
its uncertainty on a bench.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.planar import (
    FEWEST_FRAMES,
    PlanarAngle,
    PlaneReference,
    fit_plane,
    in_plane_angle,
    turn_sigma_deg,
    wrapped_deg,
)
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Corners, Refusal
from calibration.verdict import Assessment, floor, limit, rests_on
from drivers.errors import CalibrationError, counted
from drivers.types import Image

Array = NDArray[np.floating]


class MarkerAngle:
    """Measures the rotation of two markers since a reference at rest, which defines plane and zero.

    Corners are refined by their edges. tracker: of the two markers. camera: calibrated model; without it the
    tilt is unknown, and lens distortion is not corrected.
    """

    def __init__(self, tracker: MarkerTracker, camera: CameraModel | None = None) -> None:
        self._tracker, self._camera = tracker, camera
        self._plane: PlaneReference | None = None
        self._zero_deg = self.zero_sigma_deg = 0.0

    def forget(self) -> None:
        """Search the whole next picture, for example after a pause."""
        self._tracker.forget()

    def find(self, picture: Image) -> Corners | Refusal:
        """Find both markers' corners, (2, 4, 2) px, in the next (H, W) uint8 picture, or the reason."""
        return self._tracker.detect(picture)

    def set_reference(self, still: Sequence[Corners]) -> PlaneReference:
        """Set the reference from corners at rest, of at least 10 pictures; 30 are better.

        Raises `CalibrationError` if they are too few or move.
        """
        self._plane = fit_plane(np.array(still), self._camera)
        angles = np.array([in_plane_angle(corners, self._plane).angle_deg for corners in still])
        self._zero_deg = float(angles.mean())
        self.zero_sigma_deg = float(angles.std(ddof=1) / np.sqrt(len(angles)))
        return self._plane

    def take_reference(self, pictures: Sequence[Image]) -> PlaneReference:
        """Find the markers in (H, W) uint8 pictures at rest, and set the reference from them.

        Raises `CalibrationError` with the counts if too few pictures show both markers, or they move.
        """
        found = [self.find(picture) for picture in pictures]
        still = [corners for corners in found if not isinstance(corners, Refusal)]
        if len(still) < FEWEST_FRAMES:
            refusals = Counter(str(reason) for reason in found if isinstance(reason, Refusal))
            raise CalibrationError(
                f"markers: both are found in {len(still)} of {counted(len(pictures), 'picture')}, "
                f"at least {FEWEST_FRAMES} are needed (refused: {dict(refusals)}); "
                "check ids, dictionary, light and size"
            )
        return self.set_reference(still)

    def turn(self, corners_px: Corners) -> PlanarAngle | Refusal:
        """Return the rotation of (2, 4, 2) px corners. Raises `CalibrationError` without a reference."""
        if self._plane is None:
            raise CalibrationError("markers: no reference yet; take one from 10 pictures at rest")
        angle = in_plane_angle(corners_px, self._plane)
        if not angle.in_plane:
            return Refusal.OUT_OF_PLANE
        return replace(angle, angle_deg=wrapped_deg(angle.angle_deg - self._zero_deg))

    def measure(self, picture: Image) -> PlanarAngle | Refusal:
        """Return the rotation in the next (H, W) uint8 picture, or why there is none. Raises as `turn`."""
        seen = self.find(picture)
        return seen if isinstance(seen, Refusal) else self.turn(seen)


@dataclass(frozen=True, slots=True, eq=False)
class MarkerReport:
    """Results of the measurement on pictures at rest.

    plane: of the reference. rest_deg: (N,) angles at rest, deg; sigma_deg: their one sigma.
    corners_px: (M, 2, 4, 2), of the pictures after the reference in which both markers were found.
    drift_deg: change from the first to the last quarter. refused: number of pictures by reason.
    plane_sigma_deg, camera_sigma_deg: uncertainty of a rotation by `TURN_DEG` from the reference corners and
    from the camera.
    """

    assessment: Assessment
    plane: PlaneReference
    rest_deg: Array
    corners_px: Array
    sigma_deg: float
    drift_deg: float
    refused: dict[str, int]
    plane_sigma_deg: float
    camera_sigma_deg: float


TURN_DEG = 30.0
"""Rotation for which the uncertainty is stated, as large as a slip; it grows with the rotation."""


def assess_markers(pictures: Sequence[Image], angle: MarkerAngle) -> MarkerReport:
    """Measure the uncertainty of the angle at rest: reference from the first half, angles of the second half.

    Raises `CalibrationError` for fewer than 20 pictures, or if the markers are not seen at rest.
    """
    if len(pictures) < 2 * FEWEST_FRAMES:
        raise CalibrationError(
            f"markers: {counted(len(pictures), 'picture')} at rest; at least {2 * FEWEST_FRAMES} are needed"
        )
    half = max(FEWEST_FRAMES, len(pictures) // 2)
    plane = angle.take_reference(pictures[:half])
    seen = [angle.find(picture) for picture in pictures[half:]]
    answers = [found if isinstance(found, Refusal) else angle.turn(found) for found in seen]
    rest = np.array([a.angle_deg for a in answers if not isinstance(a, Refusal)])
    refused = dict(Counter(str(a) for a in answers if isinstance(a, Refusal)))
    if len(rest) < 5:
        raise CalibrationError(
            f"markers: an angle is found in {len(rest)} of {counted(len(answers), 'picture')} at rest "
            f"({refused})"
        )
    quarter = max(len(rest) // 4, 1)
    drift = float(rest[-quarter:].mean() - rest[:quarter].mean())
    sigma = float(rest.std(ddof=1))
    parts = turn_sigma_deg(plane, TURN_DEG)
    doubts = rests_on("camera", () if plane.camera is None else plane.camera.doubts)
    assessment = _assess(plane, sigma, drift, len(rest) / len(answers)) + _assess_turn(*parts) + doubts
    corners = np.array([found for found in seen if not isinstance(found, Refusal)])
    return MarkerReport(assessment, plane, rest, corners, sigma, drift, refused, *parts)


def _assess_turn(plane_deg: float, camera_deg: float) -> Assessment:
    """Assess the uncertainty of a rotation; the reason names its main cause."""
    cause = (
        f"{camera_deg:.3f} of it from the camera's intrinsics: calibrate it again, with tilted, nearer views"
        if camera_deg > plane_deg
        else "by the corners at rest: more light, larger markers, less tilt"
    )
    text = f"a rotation of {TURN_DEG:.0f} degrees is known only to {{value:.3f}} degrees, " + cause
    return limit(float(np.hypot(plane_deg, camera_deg)), 0.1, 1.0, text)


def _assess(plane: PlaneReference, sigma_deg: float, drift_deg: float, answered: float) -> Assessment:
    return (
        floor(
            plane.side_px, 30.0, 16.0, "markers are {value:.0f} px wide; 40 px and more are good: move nearer"
        )
        + limit(
            sigma_deg, 0.05, 1.0,
            "the angle at rest has a sigma of {value:.3f} degrees: more light, larger markers",
        )
        + limit(abs(drift_deg), 0.05, 1.0, "the angle drifted by {value:.3f} degrees: did something move?")
        + limit(plane.tilt_deg or 0.0, 30.0, 60.0, "the markers are tilted by {value:.0f} degrees")
        + limit(
            plane.fit_px, 0.3, 1.0,
            "two equal squares fit only to {value:.2f} px: are the markers flat and equal?",
        )
        + floor(answered, 0.98, 0.5, "{value:.0%} of the pictures gave an angle")
    )  # fmt: skip
