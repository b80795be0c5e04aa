"""Estimate intrinsics from views of a board, select the lens model on held-out views, assess, and plan views.

The residual of the fit itself is no evidence: fifteen square-on views fit to 0.06 px and project with an
error of 15 px. So every figure here comes from held-out views or from the covariance.

Projection uncertainty over the picture is mrcal's method (`mrcal-show-projection-uncertainty`): an error that
a rotation of the camera compensates does not count, so the best rotation is removed first.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.camera.model import LENS_MODELS, CameraModel, LensModel
from calibration.targets.boards import View, coverage, outside, usable_views
from calibration.verdict import Assessment, Rejected, limits
from drivers.errors import CalibrationError, plural
from drivers.progress import steps
from drivers.types import Pose

Array = NDArray[np.floating]

FEWEST_VIEWS = 3
"""Fewest views of the board for a calibration."""
_BAD_VIEW = 3.0
"""A view is rejected above this multiple of the median error."""
_LEAST_BAD_PX = 0.3
"""Views with a smaller error are never rejected."""
_WORTH = 0.99
"""A richer lens model must reduce the error on held-out views at least to this fraction; else the simpler one
is chosen."""
_GRID = (16, 12)
"""Columns and rows of the grid over the picture, including its border."""
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A camera fitted to views.

    rotations, translations: (V, 3) each, `camera_T_board` as rotation vector (rad) and m. view_rms_px: (V,),
    rms distance of corners per view, as OpenCV computes it.
    """

    lens: LensModel
    camera: CameraModel
    views: tuple[View, ...]
    rotations: Array
    translations: Array
    rms_px: float
    view_rms_px: Array


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """The selected fit, and its error on held-out views.

    covariance: (P, P) of the lens' free terms, in the order of `lens.free`, scaled by the estimated corner
    noise. noise_px: one sigma of a corner coordinate. held_out_px: rms distance of corners in held-out views,
    by lens model.
    """

    fit: Fit
    covariance: Array
    noise_px: float
    held_out_px: dict[str, float]
    rejected: tuple[Rejected, ...]

    @property
    def held_out_rms_px(self) -> float:
        return self.held_out_px[self.fit.lens.name]

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def calibrate_camera(views: Sequence[View], folds: int = 5, keep_all: bool = False) -> CameraFit:
    """Fit a camera: reject bad views, select the lens model by held-out error, fit, compute the covariance.

    keep_all: keep views that contradict the others, to see their effect.

    Raises `CalibrationError` with the rejected views and reasons if fewer than three distinct views remain,
    if a point lies outside the stated size of the pictures, or if no fit converges.
    """
    good, rejected = usable_views(views)
    if len(good) < FEWEST_VIEWS:
        why = "; ".join(f"{r.id}: {r.reason}" for r in rejected[:6]) or "none rejected"
        raise CalibrationError(
            f"camera: {len(good)} usable distinct views of the board; at least {FEWEST_VIEWS} are needed, 15 "
            f"are good ({why})"
        )
    for view in good:
        beyond = outside(view)
        if beyond is not None:
            swapped = all((other.image_px <= other.size[::-1]).all() for other in good)
            cure = "are width and height swapped?" if swapped else "is the size of the pictures right?"
            raise CalibrationError(f"camera: view {view.id}: {beyond}; {cure}")
    if not keep_all:
        good, bad = _without_bad_views(good)
        rejected += bad
    held_out = {lens.name: held_out_error(good, lens, folds) for lens in steps(LENS_MODELS)}
    chosen = LENS_MODELS[0]
    for lens in LENS_MODELS[1:]:
        if held_out[lens.name] < _WORTH * held_out[chosen.name]:
            chosen = lens
    if not np.isfinite(held_out[chosen.name]):
        raise CalibrationError("camera: no lens model could be fitted to these views")
    best = fit_camera(good, chosen)
    finite = {name: error_px for name, error_px in held_out.items() if np.isfinite(error_px)}
    return CameraFit(best, *lens_covariance(best), finite, tuple(rejected))


def fit_camera(views: Sequence[View], lens: LensModel) -> Fit:
    """Least squares over lens and all board poses. Raises `CalibrationError` if it fails."""
    board = [view.board_m.astype(np.float32) for view in views]
    seen = [view.image_px.astype(np.float32) for view in views]
    try:
        rms, matrix, distortion, turns, moves, _, _, per_view = cv2.calibrateCameraExtended(
            board, seen, views[0].size, np.eye(3), np.zeros(5), flags=lens.flags, criteria=_STOP
        )
    except cv2.error as error:
        raise CalibrationError(f"camera: no {lens.name} camera fits these views ({error.err})") from error
    terms = 8 if lens.name == "rational" else 5
    camera = CameraModel(
        views[0].size, np.asarray(matrix, np.float64), distortion.reshape(-1)[:terms].astype(np.float64)
    )
    if not (np.isfinite(rms) and np.isfinite(matrix).all() and np.isfinite(distortion).all()):
        raise CalibrationError(f"camera: the fit of a {lens.name} camera is not finite")
    rotations, translations = (np.array(v, np.float64).reshape(-1, 3) for v in (turns, moves))
    per_view_px = np.asarray(per_view, np.float64).reshape(-1)
    return Fit(lens, camera, tuple(views), rotations, translations, float(rms), per_view_px)


def held_out_error(views: Sequence[View], lens: LensModel, folds: int = 5) -> float:
    """Return the rms error in px on held-out views (their poses fitted); infinite if no fit converges."""
    folds = min(folds, len(views))
    if len(views) - -(-len(views) // folds) < FEWEST_VIEWS:
        return float("inf") if lens.name != LENS_MODELS[0].name else fit_camera(views, lens).rms_px
    squares: list[Array] = []
    for fold in range(folds):
        seen = [view for i, view in enumerate(views) if i % folds != fold]
        try:
            camera = fit_camera(seen, lens).camera
        except CalibrationError:
            return float("inf")
        squares += [_squared_distances(camera, view) for i, view in enumerate(views) if i % folds == fold]
    return float(np.sqrt(np.concatenate(squares).mean()))


def lens_covariance(fit: Fit) -> tuple[Array, float]:
    """Return the covariance (P, P) of the free lens terms, poses marginalised, and the corner noise, px.

    By QR, the part that each view's pose can explain is removed from its Jacobian. The stacked rest is
    decomposed by SVD: no normal matrix is formed or inverted.
    """
    free = [6 + c for c in fit.lens.free]
    rests, squares, count = [], 0.0, 0
    for view, turn, move in zip(fit.views, fit.rotations, fit.translations, strict=True):
        seen, jacobian = fit.camera.project_from(view.board_m, turn, move)
        pose, lens = jacobian[:, :6], jacobian[:, free]
        q, _ = np.linalg.qr(pose / np.linalg.norm(pose, axis=0))
        rests.append(lens - q @ (q.T @ lens))
        squares += float(((seen - view.image_px) ** 2).sum())
        count += 2 * len(view.ids)
    stacked = np.vstack(rests)
    noise = np.sqrt(squares / max(count - 6 * len(fit.views) - len(free), 1))
    scale = np.linalg.norm(stacked, axis=0)
    _, strengths, directions = np.linalg.svd(stacked / scale, full_matrices=False)
    spread = directions / np.maximum(strengths, 1e-12)[:, None] / scale * noise
    return spread.T @ spread, float(noise)


def neighbour_correlation(fit: Fit) -> float:
    """Return the correlation of the residuals of neighbouring corners: 0 for noise, 1 for a systematic error.

    A board that is not flat, an unsuitable lens model, and a moved focus all displace neighbouring corners in
    the same direction, while the residual of the fit may still look small.
    """
    together, alone = 0.0, 0.0
    for view, turn, move in zip(fit.views, fit.rotations, fit.translations, strict=True):
        seen, _ = fit.camera.project_from(view.board_m, turn, move)
        missed = view.image_px - seen
        apart = np.linalg.norm(view.board_m[:, None] - view.board_m[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        near = apart.argmin(axis=1)
        together += float((missed * missed[near]).sum())
        alone += float((missed**2).sum())
    return together / max(alone, 1e-12)


def _squared_distances(camera: CameraModel, view: View) -> Array:
    """Return the squared distances (N,), px^2, of a view's corners from their best projection."""
    ok, turn, move = cv2.solvePnP(view.board_m, view.image_px, camera.matrix, camera.distortion)
    if not ok:
        raise CalibrationError(f"camera: no pose fits view {view.id}")
    turn, move = cv2.solvePnPRefineLM(
        view.board_m, view.image_px, camera.matrix, camera.distortion, turn, move
    )
    seen, _ = camera.project_from(view.board_m, np.asarray(turn, np.float64), np.asarray(move, np.float64))
    return ((seen - view.image_px) ** 2).sum(axis=1)


def _without_bad_views(views: list[View]) -> tuple[list[View], list[Rejected]]:
    """Reject views with outlying errors, one per round, with their reasons.

    At most a quarter is rejected: more bad views are no exceptions. Raises `CalibrationError`.
    """
    rejected: list[Rejected] = []
    lens = LENS_MODELS[3] if len(views) >= 6 else LENS_MODELS[1]
    for _ in range(len(views) if len(views) >= 6 else 0):
        fit = fit_camera(views, lens)
        bound = max(_BAD_VIEW * float(np.median(fit.view_rms_px)), _LEAST_BAD_PX)
        worst = int(np.argmax(fit.view_rms_px))
        if fit.view_rms_px[worst] <= bound:
            break
        error = f"misses the others' camera by {fit.view_rms_px[worst]:.2f} px, limit {bound:.2f} px"
        rejected.append(Rejected(views[worst].id, error))
        views = [view for i, view in enumerate(views) if i != worst]
        if len(rejected) > (len(views) + len(rejected)) // 4:
            raise CalibrationError(
                f"camera: more than a quarter of the views contradict the others "
                f"({rejected[-1].id}: {error}); did focus or zoom move, or is the board bent?"
            )
    return views, rejected


def board_tilts_deg(result: CameraFit) -> tuple[float, float]:
    """Return the largest angle between the board's normals in two views, and to the optical axis, deg."""
    normals = Rotation.from_rotvec(result.fit.rotations).as_matrix()[:, :, 2]
    sines = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    spread = np.degrees(np.arctan2(sines, np.abs(normals @ normals.T))).max()
    tilts = np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), np.abs(normals[:, 2]))
    return float(spread), float(np.degrees(tilts).max())


def covered_share(result: CameraFit) -> float:
    return float((coverage(result.fit.views) > 0).mean())


def projection_sigma_px(result: CameraFit) -> Array:
    """Return one sigma of the projection of a distant point, in the worst direction, (12, 16) px."""
    camera = result.fit.camera
    rays = camera.rays(camera.grid_px(*_GRID))
    _, jacobian = camera.project_from(rays, np.zeros(3), np.zeros(3))
    turn, lens = jacobian[:, :3], jacobian[:, [6 + c for c in result.fit.lens.free]]
    q, _ = np.linalg.qr(turn)
    moved = (lens - q @ (q.T @ lens)).reshape(len(rays), 2, -1)
    spread = moved @ result.covariance @ moved.transpose(0, 2, 1)
    return np.sqrt(np.linalg.eigvalsh(spread)[:, -1]).reshape(_GRID[::-1])


def camera_difference_px(one: CameraModel, other: CameraModel) -> Array:
    """Return the differences in projection between two cameras, (12, 16, 2) px, best rotation removed.

    Raises `CalibrationError` for cameras of different picture sizes.
    """
    if one.size != other.size:
        raise CalibrationError(
            f"cameras differ in picture size: {one.size} and {other.size}; nothing to compare"
        )
    points = one.grid_px(*_GRID)
    rays = one.rays(points)

    def residuals(turn: Array) -> Array:
        return (other.project(Rotation.from_rotvec(turn).apply(rays)) - points).reshape(-1)

    best = least_squares(residuals, np.zeros(3), method="lm", x_scale="jac")
    return np.asarray(best.fun, np.float64).reshape(*_GRID[::-1], 2)


def assess_camera(result: CameraFit) -> Assessment:
    """Assess a camera fit by tilt, focal uncertainty, coverage, number of views and held-out error."""
    views = len(result.fit.views)
    focal = float(result.sigma[:2].max() / result.fit.camera.matrix[0, 0])
    # square-on views do not determine the focal length; a single tilt determines it badly
    spread_deg, largest_deg = board_tilts_deg(result)
    hint = "tilt the board by 30 degrees each way"
    if spread_deg < 10.0 and largest_deg < 15.0:
        text = f"all views are square-on (tilted by {largest_deg:.1f} degrees at most): {hint}"
        tilts = Assessment(refusals=(text,))
    else:
        tilts = limits(
            (spread_deg, 20.0, 0.0, "the board's tilt varied only by {value:.1f} degrees: " + hint,
             "the board's tilt varied by {value:.1f} degrees"),
        )  # fmt: skip
    correlated = limits(
        (neighbour_correlation(result.fit), 0.4, np.inf,
         "errors of neighbouring corners are correlated ({value:.2f}; noise: 0): focus moved, or board bent?",
         "correlation of the errors of neighbouring corners: {value:.2f}"),
    )  # fmt: skip
    return correlated + tilts + limits(
        (100 * focal, 0.5, 10.0, "the focal length is known only to {value:.2g} %: add tilted, nearer views"),
        (result.held_out_rms_px / max(result.fit.rms_px, 0.02), 2.0, 10.0,
         "held-out views have {value:.1f} times the error of fitted ones: something moved, or too few views"),
        (float(projection_sigma_px(result).max()), 0.5, np.inf,
         "projection is uncertain by up to {value:.2f} px in the picture: add nearer views, tilted by 30 "
         "degrees, over its corners"),
        (covered_share(result), 0.6, 0.0,
         "corners cover {value:.0%} of the picture; the lens is extrapolated elsewhere: add views there"),
        (views, 10, 3, f"{plural(views, 'distinct view')}; ten to twenty are good"),
        (result.noise_px, 1.0, 5.0, "corners are found only to {value:.2f} px: is the board in focus?"),
    )  # fmt: skip


_BORDER_PX = 8.0
"""Corners nearer to the border count as outside the picture."""
_LEAST_FACING = 0.6
"""Cosine of the largest angle at which a board is still detected reliably."""
_INTRINSIC = 6
"""Number of estimated terms: focal lengths, principal point, two radial terms."""
_CELLS, _NEW_CELL = (8, 6), 0.1
"""Grid cells of the picture, and the gain of a cell without a view so far, in units of log information."""
Cells = frozenset[tuple[int, int]]


def most_telling(
    camera: CameraModel,
    points_m: Array,
    camera_T_board: Sequence[Pose],  # noqa: N803 - frame names keep their case
    count: int,
) -> list[int]:
    """Choose views, by index, that together determine the camera best; the most informative first.

    points_m: (N, 3) of the board. Views that do not show all of it, well inside the picture and not too
    oblique, are not chosen. Each view's own pose is treated as unknown. A view in an area without views so
    far counts more, because the lens is extrapolated outside the observed area.
    """
    known_views = {i: _information(camera, points_m, pose) for i, pose in enumerate(camera_T_board)}
    left = {i: known for i, known in known_views.items() if known is not None}
    whole, seen, chosen = 1e-6 * np.eye(_INTRINSIC), Cells(), []
    while left and len(chosen) < count:
        worth = {
            i: np.linalg.slogdet(whole + information)[1] + _NEW_CELL * len(cells - seen)
            for i, (information, cells) in left.items()
        }
        best = max(worth, key=lambda i: worth[i])
        information, cells = left.pop(best)
        whole, seen = whole + information, seen | cells
        chosen.append(best)
    return chosen


def _information(camera: CameraModel, points_m: Array, pose: Pose) -> tuple[Array, Cells] | None:
    """Return the information (6, 6) on the camera's terms, pose eliminated, and the view's grid cells.

    None if the board is not seen well.
    """
    in_camera = pose.rotation.apply(points_m) + np.asarray(pose.position_m)
    sight = in_camera.mean(axis=0)
    facing = float(pose.rotation.as_matrix()[:, 2] @ sight) / float(np.linalg.norm(sight))
    if in_camera[:, 2].min() <= 0.05 or abs(facing) < _LEAST_FACING:
        return None
    pixels, jacobian = cv2.projectPoints(
        np.asarray(points_m, float), pose.rotation.as_rotvec(), np.asarray(pose.position_m, float),
        np.asarray(camera.matrix, float), np.zeros(5),
    )  # fmt: skip
    inside = (pixels > _BORDER_PX) & (pixels < np.subtract(camera.size, 1 + _BORDER_PX))
    if not inside.all():
        return None
    view, own = jacobian[:, :6], jacobian[:, 6 : 6 + _INTRINSIC].copy()
    own[:, :2] *= camera.matrix[0, 0]
    own[:, 2:4] *= camera.size[0]
    across = own.T @ view
    cells = np.floor(pixels.reshape(-1, 2) / camera.size * _CELLS).astype(int)
    information = own.T @ own - across @ np.linalg.pinv(view.T @ view) @ across.T
    return np.asarray(information), frozenset(map(tuple, cells.tolist()))
