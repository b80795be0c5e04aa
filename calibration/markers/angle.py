"""Measure the rotation of two markers of equal size since a reference at rest, from picture to degrees.

This is the only marker measurement: it gives the ground truth of lifts, and `rig calibrate markers` measures
its uncertainty on a bench.

Corners of each picture are mapped to the markers' plane by the homography of the averaged static reference,
under which the markers are squares of equal side. In that plane the eight corners rotate as one rigid body at
any tilt of the camera; one rotation is fitted to all of them. On simulated corners this is the most accurate
of the known methods at every tilt: the pixel formula is wrong by 1 degree at 15 degrees of tilt, and the
rotation magnitude of a pose is worst for a frontal camera.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Corners, Refusal, side_lengths
from calibration.verdict import Assessment, limits, rests_on
from drivers.errors import CalibrationError, plural
from drivers.types import Image

Array = NDArray[np.floating]

SQUARE = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
"""A marker of side 1 in its plane, y up, clockwise from the top left."""


def image_T_plane(parameters: Array, camera_matrix: Array | None) -> Array:  # noqa: N802
    """Return the homography (3, 3) of `solve`'s parameters."""
    if camera_matrix is None:
        return np.append(parameters[:8], 1.0).reshape(3, 3)
    pose = Rotation.from_rotvec(parameters[:3]).as_matrix()
    pose[:, 2] = parameters[3:6]
    return camera_matrix @ pose


def _two_poses(rays_T_plane: Array) -> list[Array]:  # noqa: N803
    """Return the pose (6,) of a homography, and the one with mirrored tilt, which looks almost the same.

    OpenCV's IPPE_SQUARE returns both as well, but NaN for a plane square to the camera.
    """
    pose = rays_T_plane / np.linalg.norm(rays_T_plane[:, :2], axis=0).mean()
    pose = pose * np.sign(pose[2, 2])
    left, _, right = np.linalg.svd(pose[:, :2], full_matrices=False)
    axes = left @ right
    turn = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    sight = Rotation.align_vectors([[0.0, 0.0, 1.0]], [pose[:, 2]])[0]
    mirror = np.diag([1.0, 1.0, -1.0])
    from_sight = sight.as_matrix()
    leaning_back = from_sight.T @ mirror @ from_sight @ turn @ mirror
    return [np.append(Rotation.from_matrix(r).as_rotvec(), pose[:, 2]) for r in (turn, leaning_back)]


def _corners_in_plane(second: Array) -> Array:
    c, s = np.cos(second[2]), np.sin(second[2])
    return np.vstack([SQUARE, SQUARE @ np.array([[c, s], [-s, c]]) + second[:2]])


def solve(ideal_px: Array, camera_matrix: Array | None, noise_px: float) -> tuple[Array, Array, float]:
    """Fit the plane of both markers, seen by a camera of known matrix, or by an unknown camera (None).

    Returns the best parameters (P,), one-sigma directions (P, P) as rows, and the rms residual in px.
    Parameters: the plane's pose (6), or without a camera a homography (8); then x, y and rotation of the
    second marker in the plane of the first. Unit of the plane: a marker's side.
    """

    def residuals(parameters: Array) -> Array:
        plane = np.column_stack([_corners_in_plane(parameters[-3:]), np.ones(8)])
        rays = plane @ image_T_plane(parameters, camera_matrix).T
        return (rays[:, :2] / rays[:, 2:] - ideal_px.reshape(8, 2)).reshape(-1)

    seen = cv2.getPerspectiveTransform(SQUARE.astype(np.float32), ideal_px[0].astype(np.float32))
    first = np.asarray(seen, dtype=np.float64)
    fits = []
    # one small marker allows two poses; the second marker resolves the ambiguity
    poses = None if camera_matrix is None else _two_poses(np.linalg.solve(camera_matrix, first))
    for guess in poses or [first.reshape(-1)[:8]]:
        back = np.linalg.inv(image_T_plane(guess, camera_matrix))
        corners = cv2.perspectiveTransform(ideal_px[1][None], back)[0]
        centre = corners.mean(axis=0)
        turn = np.angle(((SQUARE @ (1, 1j)).conj() * ((corners - centre) @ (1, 1j))).sum())
        start = np.concatenate([guess, centre, [turn]])
        fits.append(least_squares(residuals, start, method="lm", x_scale="jac"))
    best = min(fits, key=lambda fit: fit.cost)
    _, strengths, directions = np.linalg.svd(best.jac, full_matrices=False)
    if not best.success or strengths[-1] < 1e-12 * strengths[0]:
        raise CalibrationError(
            "markers: no plane fits the corners; are the two markers where they should be?"
        )
    free = best.fun.size - best.x.size
    sigma = max(np.sqrt(2 * best.cost / free), noise_px)
    return best.x, directions * (sigma / strengths)[:, None], float(np.sqrt(2 * best.cost / 8))


FEWEST_FRAMES = 10
_WORST_FIT_PX = 1.0
"""Largest residual of two equal squares for markers of up to 100 px; it grows with their side."""
_WORST_SCATTER_PX = 1.0  # standard deviation of a corner at rest
_SMALLEST_AREA_PX = 64.0
"""Smallest area of a marker, px squared; it is negative if corners are not clockwise."""
_USUAL_PX = 0.15
"""Residual up to which a corner gets full weight; in noisy pictures, three sigma instead."""
_REWEIGHTED = 4
"""Most rounds of reweighting."""
_MUST_AGREE = 6
"""Number of the eight corners that must agree; an object that covers an edge disturbs its two corners."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneReference:
    """The markers' plane in a static reference.

    corners_px: (2, 4, 2), mean corners. plane_T_image: (1 + P + L, 3, 3), map undistorted px to the plane
    (unit: a marker's side, x right, y up). The first one is the estimate. The others are variants of it, each
    changed by one sigma along one direction of uncertainty: P directions of the fit, and L directions of the
    camera, whose changed cameras are in `off`. template: (1 + P + L, 8) complex, the reference corners in
    that plane, centred. normal_camera: (3,) unit vector towards the camera in camera axes, None without
    intrinsics. tilt_deg: angle between it and the optical axis. distance_sides: from the camera to the middle
    of both markers, in marker sides. scatter_px: one sigma of a corner coordinate over the reference frames.
    fit_px: rms residual of the mean corners from two perfect squares.
    """

    corners_px: Array
    plane_T_image: Array  # noqa: N815
    template: NDArray[np.complex128]
    side_px: float
    scatter_px: float
    fit_px: float
    camera: CameraModel | None
    off: tuple[CameraModel, ...]
    normal_camera: Array | None
    tilt_deg: float | None
    distance_sides: float | None

    def undistort(self, corners_px: Array) -> Array:
        """Return the corners undistorted for each homography, (1 + P + L, 8, 2) px."""
        seen = corners_px if self.camera is None else self.camera.undistort(corners_px)
        same = np.broadcast_to(seen, (len(self.plane_T_image) - len(self.off), *seen.shape))
        each = [camera.undistort(corners_px) for camera in self.off]
        return np.concatenate([same, np.reshape(each, (-1, *seen.shape))]).reshape(-1, 8, 2)


@dataclass(frozen=True, slots=True)
class PlanarAngle:
    """The markers' rotation since the reference.

    angle_deg: in (-180, 180], positive counter-clockwise in the picture. sigma_deg: one sigma, from this
    frame's corners, the reference's homography and the camera; without the uncertainty of the reference's
    zero. residual_px: rms distance of the six nearest corners from a rigid rotation. scale: growth since the
    reference. in_plane: False if residual or scale show another motion; the angle is then unreliable.
    """

    angle_deg: float
    sigma_deg: float
    residual_px: float
    scale: float
    in_plane: bool


def fit_plane(corners_px: Array, camera: CameraModel | None = None) -> PlaneReference:
    """Fit the markers' plane to the mean of static frames.

    corners_px: (N, 2, 4, 2) px, N >= 10, from a `MarkerTracker`. The markers are squares of equal side; the
    pose of the second one is estimated. Raises `CalibrationError` if there are too few frames, the markers
    move, or no plane fits.
    """
    _check_static(corners_px)
    mean = corners_px.mean(axis=0)
    ideal = mean if camera is None else camera.undistort(mean)
    scatter = float(np.sqrt(corners_px.var(axis=0, ddof=1).mean()))
    matrix = None if camera is None else camera.matrix
    parameters, spread, fit = solve(ideal, matrix, scatter / np.sqrt(len(corners_px)))
    side = float(side_lengths(ideal).mean())
    if fit > _WORST_FIT_PX * max(1.0, side / 100):
        raise CalibrationError(
            f"markers: two equal squares in one plane fit only to {fit:.2f} px; "
            "check that both are flat, equal in size and undamaged"
        )
    shifted = np.vstack([parameters, parameters + spread])
    off = () if camera is None else tuple(camera.off_by_one_sigma())
    planes = [image_T_plane(p, matrix) for p in shifted]
    for other in off:
        found, *_ = solve(other.undistort(mean), other.matrix, 0.0)
        planes.append(image_T_plane(found, other.matrix))
    inverse = np.array([np.linalg.inv(plane) for plane in planes])
    normal = tilt_deg = distance = None
    if camera is not None:
        turn, (x, y) = Rotation.from_rotvec(parameters[:3]), _corners_in_plane(parameters[-3:]).mean(axis=0)
        normal = turn.as_matrix()[:, 2]
        tilt_deg = float(np.degrees(np.arctan2(np.hypot(*normal[:2]), -normal[2])))
        distance = float(np.linalg.norm(turn.apply([x, y, 0.0]) + parameters[3:6]))
    reference = PlaneReference(
        mean, inverse, np.empty(0, np.complex128), side, scatter, fit, camera, off, normal, tilt_deg, distance
    )
    return replace(reference, template=_in_plane(inverse, reference.undistort(mean)))


def in_plane_angle(corners_px: Array, reference: PlaneReference) -> PlanarAngle:
    """Measure the rotation of (2, 4, 2) px corners since the reference.

    The rotation minimises the squared distances of all eight corners, in closed form. Its argument comes from
    atan2, which, unlike arccos, neither folds nor biases small angles. Corners that do not rotate with the
    others, for example if an object covers an edge, get less weight. Raises `CalibrationError` for NaN or
    infinite corners.
    """
    if not np.isfinite(corners_px).all():
        raise CalibrationError("markers: a corner is NaN or infinite; refuse the frame instead")
    ideal = reference.undistort(corners_px)
    points, template = _in_plane(reference.plane_T_image, ideal), reference.template
    # 1 if all corners rotate together, else Cauchy weights
    usual = max(_USUAL_PX, 3.0 * reference.scatter_px) / reference.side_px
    weights = np.ones(8)
    for _ in range(_REWEIGHTED):
        _, missed, _ = _rigid_turn(points[:1], template[:1], weights)
        if missed.max() <= usual:
            break
        weights = 1.0 / (1.0 + (missed[0] / usual) ** 2)
    turn, missed, size = _rigid_turn(points, template, weights)
    from_reference = float(np.linalg.norm(_apart(turn)))
    # 16 coordinates minus rotation, scale and two of translation; counted by weight
    freedom = max(2.0 * weights.sum() - 4.0, 1.0)
    from_frame = np.sqrt((weights * missed[0] ** 2).sum() / freedom / size[0])
    nearest = np.sort(missed[0])[:_MUST_AGREE]
    residual = float(np.sqrt(np.mean(nearest**2))) * reference.side_px
    scale = float(abs(turn[0]))
    return PlanarAngle(
        angle_deg=float(np.degrees(np.angle(turn[0]))),
        sigma_deg=float(np.degrees(np.hypot(from_frame, from_reference))),
        residual_px=residual,
        scale=scale,
        in_plane=residual <= max(0.75, 0.02 * reference.side_px) and abs(scale - 1.0) <= 0.1,
    )


def turn_sigma_deg(reference: PlaneReference, turn_deg: float) -> tuple[float, float]:
    """Return one sigma of a rotation by `turn_deg` caused by the reference's corners, and by the camera.

    Both grow with the rotation, because a wrong tilt of the plane maps circles to ellipses.
    """
    ideal, plane_T_image = reference.undistort(reference.corners_px), reference.plane_T_image[0]  # noqa: N806
    rays = np.column_stack([ideal[0], np.ones(8)]) @ plane_T_image.T
    points = (rays[:, 0] + 1j * rays[:, 1]) / rays[:, 2]
    turned = points.mean() + (points - points.mean()) * np.exp(1j * np.radians(turn_deg))
    back = np.linalg.solve(plane_T_image, np.stack([turned.real, turned.imag, np.ones(8)])).T
    seen = back[:, :2] / back[:, 2:]
    if reference.camera is not None:
        seen = reference.camera.project(np.linalg.solve(reference.camera.matrix, back.T).T)
    found = _in_plane(reference.plane_T_image, reference.undistort(seen.reshape(2, 4, 2)))
    apart = _apart(_rigid_turn(found, reference.template, np.ones(8))[0])
    split = len(apart) - len(reference.off)
    parts = np.degrees([np.linalg.norm(apart[:split]), np.linalg.norm(apart[split:])])
    return float(parts[0]), float(parts[1])


def _apart(turn: NDArray[np.complex128]) -> Array:
    """Return the differences (V - 1,) in rad between the one-sigma variants and the first rotation."""
    return np.angle(turn[1:] * turn[0].conj())


def _rigid_turn(
    points: NDArray[np.complex128], template: NDArray[np.complex128], weights: Array
) -> tuple[NDArray[np.complex128], Array, Array]:
    """Return rotation and scale (V,) from (V, 8) templates to points, residuals (V, 8), and sizes (V,)."""
    total = weights.sum()
    points = points - (points @ weights / total)[:, None]
    template = template - (template @ weights / total)[:, None]
    size = np.abs(template) ** 2 @ weights
    turn = (template.conj() * points) @ weights / size
    return turn, np.abs(points - turn[:, None] * template), size


def wrapped_deg(angle_deg: float) -> float:
    """Return the same angle in (-180, 180]."""
    return 180.0 - float((180.0 - angle_deg) % 360.0)


def _in_plane(plane_T_image: Array, ideal_px: Array) -> NDArray[np.complex128]:  # noqa: N803
    """Map (V, 8, 2) px corners by each of V homographies; return (V, 8) complex, centred."""
    flat = np.concatenate([ideal_px, np.ones((*ideal_px.shape[:2], 1))], axis=2)
    rays = flat @ plane_T_image.transpose(0, 2, 1)
    points = (rays[..., 0] + 1j * rays[..., 1]) / rays[..., 2]
    return points - points.mean(axis=1, keepdims=True)


def _check_static(corners_px: Array) -> None:
    count = len(corners_px)
    if corners_px.shape[1:] != (2, 4, 2) or count < FEWEST_FRAMES:
        raise CalibrationError(
            f"markers: a reference needs {FEWEST_FRAMES} frames of (2, 4, 2) corners, got {corners_px.shape}"
        )
    if not np.isfinite(corners_px).all():
        raise CalibrationError("markers: the reference contains NaN or infinite corners; measure it again")
    x, y = np.moveaxis(corners_px.mean(axis=0), -1, 0)
    areas = 0.5 * (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1)  # shoelace formula
    if (areas < _SMALLEST_AREA_PX).any():
        raise CalibrationError(
            "markers: corners in the reference span no plane; are they in clockwise order?"
        )
    worst = float(corners_px.std(axis=0).max())
    if worst > _WORST_SCATTER_PX:
        raise CalibrationError(
            f"markers: a corner moved by {worst:.1f} px (1 sigma) in the reference; it must be at rest"
        )


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
                f"markers: both are found in {len(still)} of {plural(len(pictures), 'picture')}, "
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
    from the camera; the latter is None without a camera, whose lens and angle of view are then unknown.
    """

    assessment: Assessment
    plane: PlaneReference
    rest_deg: Array
    corners_px: Array
    sigma_deg: float
    drift_deg: float
    refused: dict[str, int]
    plane_sigma_deg: float
    camera_sigma_deg: float | None


TURN_DEG = 30.0
"""Rotation for which the uncertainty is stated, as large as a slip; it grows with the rotation."""
NO_CAMERA = "the effect of the lens and of a tilt is unknown without intrinsics (--camera)"


def assess_markers(pictures: Sequence[Image], angle: MarkerAngle) -> MarkerReport:
    """Measure the uncertainty of the angle at rest: reference from the first half, angles of the second half.

    Raises `CalibrationError` for fewer than 20 pictures, or if the markers are not seen at rest.
    """
    if len(pictures) < 2 * FEWEST_FRAMES:
        raise CalibrationError(
            f"markers: {plural(len(pictures), 'picture')} at rest; at least {2 * FEWEST_FRAMES} are needed"
        )
    half = max(FEWEST_FRAMES, len(pictures) // 2)
    plane = angle.take_reference(pictures[:half])
    seen = [angle.find(picture) for picture in pictures[half:]]
    answers = [found if isinstance(found, Refusal) else angle.turn(found) for found in seen]
    rest = np.array([a.angle_deg for a in answers if not isinstance(a, Refusal)])
    refused = dict(Counter(str(a) for a in answers if isinstance(a, Refusal)))
    if len(rest) < 5:
        raise CalibrationError(
            f"markers: an angle is found in {len(rest)} of {plural(len(answers), 'picture')} at rest "
            f"({refused})"
        )
    quarter = max(len(rest) // 4, 1)
    drift = float(rest[-quarter:].mean() - rest[:quarter].mean())
    sigma = float(rest.std(ddof=1))
    parts = turn_sigma_deg(plane, TURN_DEG)
    doubts = Assessment(doubts=(NO_CAMERA,))
    if plane.camera is not None:
        doubts = rests_on("camera", plane.camera.doubts)
    plane_deg, camera_deg = parts
    cause = (
        f"{camera_deg:.3f} of it from the camera's intrinsics: calibrate it again, with tilted, nearer views"
        if camera_deg > plane_deg
        else "by the corners at rest: more light, larger markers, less tilt"
    )
    assessment = limits(
        (plane.side_px, 30.0, 16.0, "markers are {value:.0f} px wide; 40 px and more are good: move nearer"),
        (sigma, 0.05, 1.0,
         "the angle at rest has a sigma of {value:.3f} degrees: more light, larger markers"),
        (abs(drift), 0.05, 1.0, "the angle drifted by {value:.3f} degrees: did something move?"),
        (plane.tilt_deg or 0.0, 30.0, 60.0, "the markers are tilted by {value:.0f} degrees"),
        (plane.fit_px, 0.3, 1.0,
         "two equal squares fit only to {value:.2f} px: are the markers flat and equal?"),
        (len(rest) / len(answers), 0.98, 0.5, "{value:.0%} of the pictures gave an angle"),
        (float(np.hypot(plane_deg, camera_deg)), 0.1, 1.0,
         f"a rotation of {TURN_DEG:.0f} degrees is known only to {{value:.3f}} degrees, {cause}"),
    )  # fmt: skip
    corners = np.array([found for found in seen if not isinstance(found, Refusal)])
    of_camera = None if plane.camera is None else camera_deg
    return MarkerReport(
        assessment + doubts, plane, rest, corners, sigma, drift, refused, plane_deg, of_camera
    )
