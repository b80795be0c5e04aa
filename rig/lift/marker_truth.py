"""The true angle of the object: rotation of two markers in the external camera, minus that of the wrist.

Angles are positive counter-clockwise in the camera's view. The same pictures, times and poses give bitwise
the same results, live and in replay, because both use the same code.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.markers.angle import FEWEST_FRAMES, MarkerAngle, PlaneReference, wrapped_deg
from calibration.targets.aruco import Corners, Refusal
from drivers.clock import NS_PER_S
from drivers.errors import CalibrationError, InputError, plural
from drivers.types import Image, Pose
from rig.tactile.angles import LONGEST_GAP_NS, MARKERS, Angles
from rig.tactile.sample import SlipSample, State

NO_ZERO = "markers: the angle has no zero yet; it is set at the end of phase A"


@dataclass(frozen=True, slots=True, eq=False)
class _Sighting:
    time_ns: int
    corners_px: Corners
    camera_R_tcp: Rotation  # noqa: N815


@dataclass(frozen=True, slots=True, eq=False)
class _Zero:
    """Markers' plane and wrist orientation at rest. axis: (3,); a rotation about it is counter-clockwise."""

    plane: PlaneReference
    camera_R_tcp: Rotation  # noqa: N815
    axis: NDArray[np.float64]

    def wrist_deg(self, camera_R_tcp: Rotation) -> float:  # noqa: N803
        """Return the rotation of the wrist about the axis since then (twist of a swing-twist split), deg."""
        turn = (camera_R_tcp * self.camera_R_tcp.inv()).as_quat()
        return float(np.degrees(2.0 * np.arctan2(turn[:3] @ self.axis, turn[3])))

    def tipped_rad(self, camera_R_tcp: Rotation) -> float:  # noqa: N803
        """Return the wrist's rotation about other axes; a wrong camera orientation adds part of it."""
        turn = (camera_R_tcp * self.camera_R_tcp.inv()).as_rotvec()
        return float(np.linalg.norm(np.cross(turn, self.axis)))


class MarkerTruth:
    """Measures the object's angle during a lift, or again from its stored pictures.

    angle: measures the rotation of the markers; this class subtracts that of the wrist, and unwraps angles
    over time. If its camera is not calibrated, the wrist's rotation is subtracted about the camera's axis
    instead of the markers' normal. base_T_camera: from the hand-eye calibration. camera_turn_sigma_rad: one
    sigma of base_T_camera's orientation, which is propagated to the wrist's share of an angle.
    """

    def __init__(
        self,
        angle: MarkerAngle,
        base_T_camera: Pose,  # noqa: N803
        camera_turn_sigma_rad: float = 0.0,
    ) -> None:
        self._angle = angle
        self._camera_R_base = base_T_camera.rotation.inv()
        self._camera_sigma = camera_turn_sigma_rad
        self._sightings: list[_Sighting] = []
        self._unseen: list[tuple[int, Refusal]] = []
        self._newest_ns: int | None = None
        self._still: list[_Sighting] = []
        self._seen_before = 0
        self._zero: _Zero | None = None
        self._angles: list[SlipSample] = []
        self._before: list[_Sighting] = []

    def newest_corners(self, since_ns: int) -> Corners | None:
        """Return the (2, 4, 2) px corners in the newest picture that shows both markers, None if older."""
        newest = self._sightings[-1] if self._sightings else None
        return None if newest is None or newest.time_ns < since_ns else newest.corners_px

    def update(self, image: Image, time_ns: int, base_T_tcp: Pose) -> Corners | None:  # noqa: N803
        """Process one picture, (H, W, 3) uint8 RGB or (H, W) uint8 grey, captured at `time_ns`.

        base_T_tcp: pose of the wrist at that time. Returns the (2, 4, 2) px corners, or None if the frame is
        refused. Raises `InputError` for another kind of picture.
        """
        if self._newest_ns is not None and time_ns <= self._newest_ns:
            return None
        self._newest_ns = time_ns
        if image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        elif image.ndim != 2:
            raise InputError(f"external camera: a (H, W, 3) uint8 RGB picture is needed, got {image.shape}")
        seen = self._angle.find(image)
        if isinstance(seen, Refusal):
            self._unseen.append((time_ns, seen))
            return None
        sighting = _Sighting(time_ns, seen, self._camera_R_base * base_T_tcp.rotation)
        self._sightings.append(sighting)
        if self._zero is not None:
            self._add(self._angles, sighting, self._zero)
        return seen

    def set_zero(self, from_ns: int, to_ns: int, earliest_ns: int | None = None) -> None:
        """Set the mean of the frames from `from_ns` to `to_ns`, both included, as the zero.

        Contract: the last frames of phase A, before the lift. earliest_ns: if fewer than 10 of them show both
        markers, the last 10 from this time on are used instead. All frames so far are measured (again)
        against the zero. Raises `CalibrationError` with the counts if fewer than 10 frames show both markers.
        The zero is computed only when an angle is requested, see `measure_zero`, because frames keep
        arriving.
        """
        still = [s for s in self._sightings if from_ns <= s.time_ns <= to_ns]
        if len(still) < FEWEST_FRAMES and earliest_ns is not None:
            from_ns = min(from_ns, earliest_ns)
            still = [s for s in self._sightings if from_ns <= s.time_ns <= to_ns][-FEWEST_FRAMES:]
        if len(still) < FEWEST_FRAMES:
            raise CalibrationError(self._too_few(len(still), from_ns, to_ns))
        self._still, self._zero = still, None
        self._seen_before = len(self._sightings) - 1

    def measure_zero(self) -> None:
        """Compute the zero, unless done. Raises `CalibrationError` if the markers move, or fit no plane."""
        if self._zero is not None or not self._still:
            return
        plane = self._angle.set_reference([s.corners_px for s in self._still])
        wrist = Rotation.concatenate([s.camera_R_tcp for s in self._still]).mean()
        # the camera's z axis points away from it, so a counter-clockwise rotation in its view is about -z
        axis = np.array([0.0, 0.0, -1.0]) if plane.normal_camera is None else plane.normal_camera
        self._zero = _Zero(plane, wrist, np.asarray(axis, np.float64))
        # Frames from before the zero are measured only when the series is requested.
        self._before = self._sightings[: self._seen_before]
        self._angles = self._measure(self._sightings[self._seen_before :], self._zero)

    def latest_angle_deg(self) -> float | None:
        """Return the newest angle, for display; None before the zero, and 50 ms after the last angle."""
        self.measure_zero()
        if not self._angles or self._newest_ns is None:
            return None
        stale = self._newest_ns - self._angles[-1].time_ns > LONGEST_GAP_NS
        return None if stale else self._angles[-1].angle_deg

    def distance_sides(self) -> float | None:
        """Return the distance from the camera to the markers' middle at the zero, in marker sides, or None.

        None without a camera calibration. Raises the errors of `series`.
        """
        self.measure_zero()
        if self._zero is None:
            raise CalibrationError(NO_ZERO)
        return self._zero.plane.distance_sides

    def series(self, zero_ns: int = 0) -> Angles:
        """Return all angles so far, without refused frames. zero_ns: see `Angles`.

        They are unwrapped over time; after a gap of more than 50 ms they restart in (-180, 180]. sigma_deg
        does not include the uncertainty of the zero. Raises `CalibrationError` before `set_zero`, and as
        `measure_zero`.
        """
        self.measure_zero()
        if self._zero is None:
            raise CalibrationError(NO_ZERO)
        return Angles.of([*self._measure(self._before, self._zero), *self._angles], MARKERS, zero_ns)

    @property
    def rests_from_ns(self) -> int:
        """Capture time of the first frame of the zero; there must be a zero."""
        return self._still[0].time_ns

    def _measure(self, sightings: Sequence[_Sighting], zero: _Zero) -> list[SlipSample]:
        angles: list[SlipSample] = []
        for sighting in sightings:
            self._add(angles, sighting, zero)
        return angles

    def _add(self, angles: list[SlipSample], sighting: _Sighting, zero: _Zero) -> None:
        """Add the angle of a frame, near the angle of the frame before; none if it is refused."""
        turn = self._angle.turn(sighting.corners_px)
        if isinstance(turn, Refusal):
            return
        wrist, time_ns = sighting.camera_R_tcp, sighting.time_ns
        joined = angles and time_ns - angles[-1].time_ns <= LONGEST_GAP_NS
        near = (angles[-1].angle_deg or 0.0) if joined else 0.0
        angle = near + wrapped_deg(turn.angle_deg - zero.wrist_deg(wrist) - near)
        wrist_sigma = np.degrees(self._camera_sigma * zero.tipped_rad(wrist)) if self._camera_sigma else 0.0
        sigma = float(np.hypot(turn.sigma_deg, float(wrist_sigma)))
        angles.append(SlipSample(time_ns, State.TRACKING, angle, sigma))

    def _too_few(self, count: int, from_ns: int, to_ns: int) -> str:
        reasons = Counter(str(reason) for time_ns, reason in self._unseen if from_ns <= time_ns <= to_ns)
        misses = ", ".join(f"{n} x {reason}" for reason, n in sorted(reasons.items())) or "none refused"
        span_s = (to_ns - from_ns) / NS_PER_S
        came = count + sum(reasons.values())
        if came < FEWEST_FRAMES:
            return (
                f"external camera: only {plural(came, 'frame')} came in {span_s:.2f} s ({count} with both "
                f"markers), the zero needs {FEWEST_FRAMES}: the computer is too busy, or the "
                "camera's connection too slow; end other programs, then see rig doctor"
            )
        return (
            f"external camera: {plural(count, 'frame')} with both markers in {span_s:.2f} s ({misses}), the "
            f"zero needs {FEWEST_FRAMES}; check the markers, their ids, the light and what hides them"
        )
