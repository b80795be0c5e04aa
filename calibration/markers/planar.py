"""The in-plane angle of two markers of equal size: rectify, fit one rotation to all corners, atan2.

Every picture goes through the homography of the averaged static reference to the markers' plane.
There the eight corners turn as one rigid body, whatever the camera's tilt; measured on simulated
corners, this is the most accurate of the known ways at every tilt (the pixel formula is off by
1 degree at 15 degrees of tilt, the rotation magnitude of a pose is worst for a frontal camera).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.plane_fit import MarkerPlane, solve
from calibration.targets.aruco import side_lengths
from drivers.errors import CalibrationError

Array = NDArray[np.floating]

FEWEST_FRAMES = 10
_WORST_FIT_PX = 1.0
_WORST_SCATTER_PX = 1.0
_SMALLEST_AREA_PX = 64.0
_USUAL_PX = 0.15
"""A corner that misses a rigid turn by no more is as others are; of a noisy picture, three sigma."""
_REWEIGHTED = 4
_MUST_AGREE = 6
"""Of the eight corners: what lies over an edge spoils the two at its ends."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneReference:
    """The markers' plane as seen in a static reference.

    corners_px: (2, 4, 2), their mean. plane_T_image: (1 + P + L, 3, 3), maps undistorted px to the plane
    (unit: a marker's side, x right, y up); the first is the answer, each other is off by one sigma along one
    direction of the fit's uncertainty (P) or of the camera's (L: the cameras `off`, which undistort by
    themselves). template: (1 + P + L, 8) complex, the reference corners in that plane, centred.
    normal_camera: (3,) unit vector towards the camera in camera axes, None without intrinsics; likewise
    tilt_deg, the angle between it and the optical axis, and distance_sides, from the camera to the middle of
    both markers, in marker sides. scatter_px: one sigma of a corner coordinate over the reference frames;
    fit_px: rms by which the mean corners miss two perfect squares.
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

    def undistorted(self, corners_px: Array) -> Array:
        """(1 + P + L, 8, 2) px: the corners as each homography takes them."""
        seen = corners_px if self.camera is None else self.camera.undistorted(corners_px)
        same = np.broadcast_to(seen, (len(self.plane_T_image) - len(self.off), *seen.shape))
        each = [camera.undistorted(corners_px) for camera in self.off]
        return np.concatenate([same, np.reshape(each, (-1, *seen.shape))]).reshape(-1, 8, 2)


@dataclass(frozen=True, slots=True)
class PlanarAngle:
    """The markers' turn since the reference.

    angle_deg: in (-180, 180], positive counter-clockwise as the camera sees it. sigma_deg: one
    sigma of this frame's corners, of the reference's homography and of the camera together, without
    the reference's own zero. residual_px: rms distance of the six nearest corners from a rigid turn. scale:
    growth since the reference. in_plane: False where residual or scale tell of another motion; the
    angle then means little.
    """

    angle_deg: float
    sigma_deg: float
    residual_px: float
    scale: float
    in_plane: bool


def fit_plane(corners_px: Array, camera: CameraModel | None = None) -> PlaneReference:
    """Fit the markers' plane to the mean of static frames.

    corners_px: (N, 2, 4, 2) px, N >= 10, as a `MarkerTracker` gives them. The markers are
    squares of equal side; where the second lies is solved for. Raises `CalibrationError` when
    there are too few frames, when they move, or when no plane fits.
    """
    _check_static(corners_px)
    mean = corners_px.mean(axis=0)
    ideal = mean if camera is None else camera.undistorted(mean)
    scatter = float(np.sqrt(corners_px.var(axis=0, ddof=1).mean()))
    model = MarkerPlane(ideal, None if camera is None else camera.matrix)
    parameters, spread, fit = solve(model, ideal, scatter / np.sqrt(len(corners_px)))
    side = float(side_lengths(ideal).mean())
    if fit > _WORST_FIT_PX * max(1.0, side / 100):
        raise CalibrationError(
            f"markers: two equal squares in one plane fit only to {fit:.2f} px; "
            "check that both are flat, equal in size and undamaged"
        )
    shifted = np.vstack([parameters, parameters + spread])
    off = () if camera is None else tuple(camera.off_by_one_sigma())
    seen_off = [_seen_by(other, mean) for other in off]
    inverse = np.array([np.linalg.inv(model.image_T_plane(p)) for p in shifted] + seen_off)
    normal, middle = model.normal_and_middle(parameters) or (None, None)
    reference = PlaneReference(
        corners_px=mean,
        plane_T_image=inverse,
        template=np.empty(0, np.complex128),
        side_px=side,
        scatter_px=scatter,
        fit_px=fit,
        camera=camera,
        off=off,
        normal_camera=normal,
        tilt_deg=None if normal is None else float(np.degrees(np.arctan2(np.hypot(*normal[:2]), -normal[2]))),
        distance_sides=None if middle is None else float(np.linalg.norm(middle)),
    )
    return replace(reference, template=_in_plane(inverse, reference.undistorted(mean)))


def _seen_by(camera: CameraModel, mean_px: Array) -> Array:
    """(3, 3) `plane_T_image` as this camera would have it."""
    ideal = camera.undistorted(mean_px)
    model = MarkerPlane(ideal, camera.matrix)
    return np.linalg.inv(model.image_T_plane(solve(model, ideal, 0.0)[0]))


def in_plane_angle(corners_px: Array, reference: PlaneReference) -> PlanarAngle:
    """Measure the turn of (2, 4, 2) px corners since the reference.

    The rotation that minimises the squared distances of all eight corners, in closed form; its
    argument comes from atan2, which neither folds nor biases small angles as arccos does. Corners that
    do not turn with the others, as where something lies over an edge, count less.
    Raises `CalibrationError` for corners that are not finite.
    """
    if not np.isfinite(corners_px).all():
        raise CalibrationError("markers: a corner is not a finite number; refuse the frame instead")
    ideal = reference.undistorted(corners_px)
    points, template = _in_plane(reference.plane_T_image, ideal), reference.template
    weights = _agreement(points[:1], template[:1], reference)
    turn, missed, size = _rigid_turn(points, template, weights)
    from_reference = float(np.linalg.norm(_apart(turn)))
    # 16 coordinates less rotation, scale and two of translation; of corners that count
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
    """One sigma of a turn by that much that stems from the reference's corners, and from the camera.

    Both grow with the turn: a plane taken for more or less tilted than it is turns circles to ellipses.
    """
    ideal, plane_T_image = reference.undistorted(reference.corners_px), reference.plane_T_image[0]  # noqa: N806
    rays = np.column_stack([ideal[0], np.ones(8)]) @ plane_T_image.T
    points = (rays[:, 0] + 1j * rays[:, 1]) / rays[:, 2]
    turned = points.mean() + (points - points.mean()) * np.exp(1j * np.radians(turn_deg))
    back = np.linalg.solve(plane_T_image, np.stack([turned.real, turned.imag, np.ones(8)])).T
    seen = back[:, :2] / back[:, 2:]
    if reference.camera is not None:
        seen = reference.camera.project(np.linalg.solve(reference.camera.matrix, back.T).T)
    found = _in_plane(reference.plane_T_image, reference.undistorted(seen.reshape(2, 4, 2)))
    apart = _apart(_rigid_turn(found, reference.template, np.ones(8))[0])
    split = len(apart) - len(reference.off)
    parts = np.degrees([np.linalg.norm(apart[:split]), np.linalg.norm(apart[split:])])
    return float(parts[0]), float(parts[1])


def _apart(turn: NDArray[np.complex128]) -> Array:
    """(V - 1,) rad by which the turns that are off by one sigma differ from the first."""
    return np.angle(turn[1:] * turn[0].conj())


def _rigid_turn(
    points: NDArray[np.complex128], template: NDArray[np.complex128], weights: Array
) -> tuple[NDArray[np.complex128], Array, Array]:
    """Turn and growth (V,) that take (V, 8) templates to points, distances left (V, 8), sizes (V,)."""
    total = weights.sum()
    points = points - (points @ weights / total)[:, None]
    template = template - (template @ weights / total)[:, None]
    size = np.abs(template) ** 2 @ weights
    turn = (template.conj() * points) @ weights / size
    return turn, np.abs(points - turn[:, None] * template), size


def _agreement(
    points: NDArray[np.complex128], template: NDArray[np.complex128], reference: PlaneReference
) -> Array:
    """(8,) weight of each corner: 1 where all turn together, else Cauchy's, reweighted. points: (1, 8)."""
    usual = max(_USUAL_PX, 3.0 * reference.scatter_px) / reference.side_px
    weights = np.ones(8)
    for _ in range(_REWEIGHTED):
        _, missed, _ = _rigid_turn(points, template, weights)
        if missed.max() <= usual:
            break
        weights = 1.0 / (1.0 + (missed[0] / usual) ** 2)
    return weights


def wrapped_deg(angle_deg: float) -> float:
    """The same angle in (-180, 180]."""
    return 180.0 - float((180.0 - angle_deg) % 360.0)


def _in_plane(plane_T_image: Array, ideal_px: Array) -> NDArray[np.complex128]:  # noqa: N803
    """(V, 8) complex, centred: (V, 8, 2) px corners through each of V homographies."""
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
        raise CalibrationError("markers: the reference holds corners that are not numbers; measure it again")
    if (_areas(corners_px.mean(axis=0)) < _SMALLEST_AREA_PX).any():
        raise CalibrationError(
            "markers: corners in the reference span no plane; are they in clockwise order?"
        )
    worst = float(corners_px.std(axis=0).max())
    if worst > _WORST_SCATTER_PX:
        raise CalibrationError(
            f"markers: a corner moved by {worst:.1f} px (1 sigma) in the reference; it must be at rest"
        )


def _areas(quads_px: Array) -> Array:
    """Areas of (M, 4, 2) px quads, positive for corners in clockwise order as seen (shoelace)."""
    x, y = quads_px[..., 0], quads_px[..., 1]
    return 0.5 * (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1)
