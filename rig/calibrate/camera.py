"""`rig calibrate camera, markers`: a camera from pictures of a board, and the noise of the marker angle.

On a bench the arm or a person shows the board in many poses; markers are seen at rest.
"""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.files import TERMS, camera_info, read_camera
from calibration.camera.intrinsics import (
    FEWEST_VIEWS,
    CameraFit,
    assess_camera,
    board_tilts_deg,
    calibrate_camera,
    camera_difference_px,
    covered_share,
    most_telling,
    projection_sigma_px,
)
from calibration.camera.model import CameraModel
from calibration.markers.angle import TURN_DEG, MarkerAngle, assess_markers
from calibration.markers.tracker import MarkerTracker
from calibration.targets.boards import Target, View, coverage, parse_target
from calibration.targets.sheets import target_picture
from calibration.verdict import Assessment, Rejected
from drivers.errors import CalibrationError, InputError
from drivers.formats import jpeg_orientation, read_beginning
from drivers.images import BEGINNING_BYTES, read_image
from drivers.progress import steps
from drivers.types import Pose
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye, capture_still
from protocols.grasps import find_grasp_file
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.twins import refuse_undrawn
from rig.calibrate import charts
from rig.calibrate.bench import Station, visits
from rig.calibrate.charts import Picture, thumbnails
from rig.calibrate.kind import (
    CameraFile,
    Differences,
    Kind,
    ObjectsFolder,
    PicturesOption,
    PosesOption,
    Samples,
    SerialOption,
    TargetOption,
)
from rig.calibrate.result import CalibrationResult, Figure
from rig.calibrate.samples import picture_files, write_picture
from rig.config import BenchConfig
from rig.config.devices import FakeArmLimits
from rig.declared import option

UNKNOWN = "unknown without intrinsics (--camera)"

_CANDIDATES = 400
_NEAREST_M, _TILTS_DEG, _INSIDE_M = 0.25, (10.0, 40.0), 0.01
_HELD_M = (0.0, 0.0, -0.03)
"""Assumed position of a board's middle on the tool."""
_STILL_FRAMES = 60


@dataclass(frozen=True)
class CameraOptions:
    """Calibrate a camera's intrinsics and lens distortion from views of a board.

    Several lens models are fitted; the one with the lowest reprojection error on held-out views is kept.

    On a bench the arm holds the board in --poses positions and tilts. Without an arm you hold it, and confirm
    each picture.

    The folder of --from holds 10 to 20 pictures of one board by one camera, at one focus and zoom. Tilt the
    board by 30 degrees in each direction, and cover the whole picture. --target names the board.

    Each corner of a chessboard is refined in a window that holds no other corner. Append :N to the target for
    a fixed window of N px. On OpenCV's own chessboard photos its recipe (--target chessboard:9x6:25:11
    --keep-all) reproduces the published numbers, with a reprojection error of 0.42 px on held-out views; the
    default of this command has 0.18 px.

    Examples:
      rig calibrate camera --bench fake --poses 20
      rig calibrate camera --bench fake --watch
      rig calibrate camera --from photos --target chessboard:9x6:25 --pictures 'left*.jpg'
    """

    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100"
    pattern: PicturesOption = "*"
    serial: SerialOption = "unknown"
    keep_all: bool = option(False, "Do not reject outliers among the views.")
    poses: PosesOption = 20


def solve_camera(samples: Samples, options: CameraOptions) -> CalibrationResult:
    """Find the target in a folder's pictures and fit the camera. Raises `InputError`."""
    folder, serial, target = samples.folder, options.serial, parse_target(options.target)
    files = {path.name: path for path in picture_files(folder, options.pattern)}
    found = {name: target.find(read_image(path, grey=True), name) for name, path in steps(files.items())}
    turns = {name: jpeg_orientation(read_beginning(path, BEGINNING_BYTES)) for name, path in files.items()}
    usual, _ = Counter(turns.values()).most_common(1)[0]
    for name in (name for name, turn in turns.items() if turn != usual):
        # the middle of the lens is elsewhere in a picture that is turned
        found[name] = f"EXIF orientation {turns[name]} differs from the others' {usual}: keep one orientation"
    rejected = [Rejected(name, reason) for name, reason in found.items() if isinstance(reason, str)]
    read = CalibrationResult(
        "camera", {"camera": serial}, {}, Assessment(), source=str(folder), rejected=rejected,
        files=list(files.values()),
    )  # fmt: skip
    try:
        fit = calibrate_camera([v for v in found.values() if isinstance(v, View)], keep_all=options.keep_all)
    except CalibrationError as error:
        return replace(
            read, assessment=Assessment((str(error),)), thumbnails=thumbnails(rejected[:12], files)
        )
    rejected = [*rejected, *fit.rejected]
    projected_px = projection_sigma_px(fit)
    return replace(
        read,
        assessment=assess_camera(fit),
        layout=camera_info(fit.fit.camera, serial),
        figures=_figures(fit, target, projected_px),
        used=len(fit.fit.views),
        rejected=rejected,
        pictures=_pictures(fit, projected_px, folder),
        thumbnails=thumbnails(rejected, files, found),
    )


def _figures(result: CameraFit, target: Target, projected_px: charts.Array) -> list[Figure]:
    """Return the figures of a camera. projected_px: see `projection_sigma_px`."""
    fit, matrix, sigma = result.fit, result.fit.camera.matrix, result.sigma
    spread_deg, largest_deg = board_tilts_deg(result)
    uncertain_px = {"median": float(np.median(projected_px)), "worst": float(projected_px.max())}
    distortion = {name: float(value) for name, value in zip(TERMS[4:], fit.camera.distortion, strict=False)}
    return [
        Figure("", np.diag(matrix)[:2], "focal length", ".2f", "px", sigma=sigma[:2]),
        Figure("", matrix[:2, 2], "principal point", ".2f", "px", sigma=sigma[2:4]),
        Figure("", distortion, "distortion", ".5g"),
        Figure("target", target.spec),
        Figure("lens_model", fit.lens.name, "lens model, the best on views held out"),
        Figure("terms", [TERMS[i] for i in fit.lens.free]),
        Figure("sigma", sigma),
        Figure("covariance", result.covariance),
        Figure("fit_rms_px", fit.rms_px, "error of the views used", ".3f", "px"),
        Figure("held_out_rms_px", result.held_out_px, "error of views held out, by lens model", ".3f", "px"),
        Figure("corner_noise_px", result.noise_px),
        Figure("projection_sigma_px", uncertain_px, "one sigma of a projected point", ".2f", "px"),
        Figure("tilt_spread_deg", spread_deg),
        Figure("largest_tilt_deg", largest_deg),
        Figure("covered", covered_share(result)),
        Figure("view_rms_px", _view_rms_px(result)),
    ]


def _view_rms_px(result: CameraFit) -> dict[str, float]:
    return {v.id: float(e) for v, e in zip(result.fit.views, result.fit.view_rms_px, strict=True)}


def _pictures(result: CameraFit, projected_px: charts.Array, folder: Path) -> list[Picture]:
    fit, size = result.fit, result.fit.camera.size
    points = np.vstack([view.image_px for view in fit.views])
    fitted, boards = [], []
    for view, turn, move in zip(fit.views, fit.rotations, fit.translations, strict=True):
        fitted.append(fit.camera.project_from(view.board_m, turn, move)[0])
        boards.append(Pose.from_rotation(move, Rotation.from_rotvec(turn)))
    projected = np.vstack(fitted)
    limit = 3.0 * float(np.median(fit.view_rms_px))
    by_lens = {k: v for k, v in result.held_out_px.items() if v < 5 * result.held_out_rms_px}
    worst = int(np.argmax(fit.view_rms_px))
    shown = fit.views[worst]
    return [
        charts.poses(
            "The board in each view, in the camera's frame. The longest axis is z, the line of sight.",
            {"board": boards, "camera": [Pose((0.0, 0.0, 0.0))]},
        ),
        charts.residuals(
            "Residuals of the worst view",
            f"{shown.id}: each arrow points from a corner projected with the calibrated camera to the "
            "detected one.",
            fitted[worst], shown.image_px - fitted[worst], size, read_image(folder / shown.id, grey=True),
        ),
        charts.residuals(
            "Residuals of all views",
            "Noise points anywhere; arrows that agree show a lens that the model does not follow.",
            projected, points - projected, size,
        ),
        charts.field(
            "Uncertainty over the picture",
            "One sigma of where a distant point is projected, the best turn of the camera taken out; dots: "
            "corners seen.",
            projected_px, size, "one sigma, px", points,
        ),
        charts.field(
            "Coverage", "Corners per cell of the picture.", coverage(fit.views), size, "corners", points
        ),
        charts.bars(
            "Error per view", "Rms residual of each view used. Dashed: three times the median.",
            _view_rms_px(result), "rms, px", limit,
        ),
        charts.bars(
            "Lens models",
            "Rms residual of views held out: the simplest model within 1 % of the best is taken.",
            by_lens, "rms, px",
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class MarkersOptions:
    """Measure the noise of the angle from two markers, on pictures of an object at rest.

    On a bench the camera takes sixty pictures of an object in its place. Nothing moves.

    The folder of --from holds at least twenty pictures, taken one after the other while nothing moves.

    Examples:
      rig calibrate markers --bench fake
      rig calibrate markers --from still --camera calibrations/camera-C1.yaml
    """

    ids: tuple[int, int] = option((0, 1), "Ids of the two markers.")
    dictionary: str = option("DICT_4X4_50", "ArUco dictionary: OpenCV's name, or a file.")
    camera_file: CameraFile = None
    pattern: PicturesOption = "*"
    serial: SerialOption = "unknown"
    object_name: str = option("wrench", "On a bench: object with the markers.", "--object")
    objects: ObjectsFolder = None


def solve_markers(samples: Samples, options: MarkersOptions) -> CalibrationResult:
    """Assess the angle from at least twenty pictures of the markers at rest. Raises `CalibrationError`."""
    lens = None if options.camera_file is None else read_camera(options.camera_file)
    return _assess_pictures(samples.folder, options, lens)


def _assess_pictures(folder: Path, options: MarkersOptions, camera: CameraModel | None) -> CalibrationResult:
    files = picture_files(folder, options.pattern)
    pictures = [read_image(path, grey=True) for path in files]
    tracker = MarkerTracker(options.ids, options.dictionary)
    report = assess_markers(pictures, MarkerAngle(tracker, camera))
    plane = report.plane
    of_turn = f"a turn of {TURN_DEG:.0f} degrees"
    tilt = Figure("tilt_deg", plane.tilt_deg, "tilt to the camera", ".1f", "degrees", top=True)
    turn = Figure("", UNKNOWN, f"{of_turn}, one sigma")
    of_camera = Figure("", UNKNOWN, f"{of_turn}, due to the camera")
    if report.camera_sigma_deg is not None:
        both_deg = float(np.hypot(report.plane_sigma_deg, report.camera_sigma_deg))
        turn = Figure("turn_sigma_deg", both_deg, turn.label, ".4f", "degrees", top=True)
        of_camera = Figure(
            "turn_sigma_camera_deg", report.camera_sigma_deg, of_camera.label, ".4f", "degrees"
        )
    if plane.tilt_deg is None:
        tilt = Figure("", UNKNOWN, tilt.label)
    figures = [
        Figure("side_px", plane.side_px, "side", ".1f", "px", top=True),
        tilt,
        Figure("angle_sigma_deg", report.sigma_deg, "angle at rest, one sigma", ".4f", "degrees", top=True),
        turn,
        of_camera,
        Figure("square_fit_px", plane.fit_px),
        Figure("drift_deg", report.drift_deg, "drift", "+.4f", "degrees"),
        Figure("refused_pictures", report.refused, "pictures without an angle"),
    ]
    places = np.arange(float(len(report.rest_deg)))
    mean = np.broadcast_to(plane.corners_px, report.corners_px.shape)
    shown = [
        charts.residuals(
            "Corners at rest",
            "Each arrow points from a corner's mean over the first half of the pictures to its place in one "
            "of the others. Scattered arrows are noise; arrows that agree show a marker that moved.",
            mean.reshape(-1, 2), (report.corners_px - mean).reshape(-1, 2), pictures[0].shape[::-1],
            pictures[0],
        ),
        charts.curves(
            "Angle at rest", "It should scatter around zero, without a trend.",
            {"angle": (places, report.rest_deg)}, "picture", "angle, degrees",
        ),
    ]  # fmt: skip
    return CalibrationResult(
        "markers", {"camera": options.serial}, {"dictionary": options.dictionary, "ids": options.ids},
        report.assessment, figures, source=str(folder), used=len(files), files=files, pictures=shown,
    )  # fmt: skip


def collect_camera(station: Station, options: CameraOptions) -> list[CalibrationResult]:
    """Show the board, firm on the tool, to the camera from several poses, and fit the camera.

    If no arm can be moved, a person holds the board in places that they choose; the poses are for a simulated
    person. Raises `OperatorStopError` unless the operator agrees to the motion or holds the board,
    `DeviceError`, `InputError`.
    """
    config, target, count = station.config, parse_target(options.target), options.poses
    spec, raw = target.spec, station.raw("camera", station.config.require("camera").serial)
    poses = _board_poses(config, target, count, station.seed)
    left = [(f"{i:03d}", pose) for i, pose in enumerate(poses, start=1)]
    kept: list[str] = []

    def keep(capture: HandEyeCapture) -> None:
        write_picture(raw / f"{capture.id}.png", capture.frame.image)
        if station.show is not None:
            station.show(capture.frame)
        kept.append(capture.id)
        station.note(f"{capture.id}: kept", len(kept), len(poses))

    if config.moves:
        with station.connection(
            f"The arm will visit {len(poses)} poses before the camera at up to {SPEED_M_S} m/s, tilted by up "
            f"to {_TILTS_DEG[1]:g} degrees, with the board {spec} on the tool.",
            motions=visits(left),
        ) as (bench, operator):
            agree_to_carry(bench, operator)
            operator.place(f"{spec}@tool", f"board {spec}, firm on the tool, facing the camera")
            capture_hand_eye(bench, lambda: left.pop(0) if left else None, keep, station.leave_out)
    else:
        with station.connection(
            f"Nothing moves. You hold the board {spec} before the camera, {len(poses)} times."
        ) as (bench, operator):
            for name, pose in left:
                operator.hold(
                    f"{name} of {len(poses)}: hold the board {spec} still, all of it in the picture, each "
                    "time elsewhere in the picture and tilted another way by 10 to 40 degrees. Is it still?",
                    f"{spec}@tool",
                    pose,
                    None,
                )
                keep(HandEyeCapture(name, pose, capture_still(bench, bench.camera, 1)[0]))
    serial = config.require("camera").serial
    return [solve_camera(Samples(raw), replace(options, pattern="*.png", serial=serial, keep_all=False))]


def _board_poses(config: BenchConfig, target: Target, count: int, seed: int) -> list[Pose]:
    """Return the tool poses that constrain the camera best, with the board on the tool, facing the camera.

    They are chosen among poses drawn all over the picture, from near to where the camera looks, inside the
    workspace. Raises `InputError` if too few of them show the whole board.
    """
    limits = FakeArmLimits() if config.arm is None else config.arm.limits
    low, high = np.array(limits.workspace_min_m), np.array(limits.workspace_max_m)
    base_T_camera, rng = config.base_T_camera(), np.random.default_rng((seed, 33))  # noqa: N806 - frame names
    camera = config.require("camera")
    half = np.divide(camera.size_px, 2.0 * camera.focal_px)
    farthest_m = config.object_distance_m()
    candidates = []
    for _ in range(_CANDIDATES):
        away_m = rng.uniform(min(_NEAREST_M, farthest_m), farthest_m)
        place = base_T_camera.rotation.apply(away_m * np.append(half * rng.uniform(-1, 1, 2), 1.0))
        axis = rng.normal(0, 1, 3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(*_TILTS_DEG)))
        turned = turn * TOOL_DOWN
        tool = place + base_T_camera.position_m - turned.apply(_HELD_M)
        if (tool > low + _INSIDE_M).all() and (tool < high - _INSIDE_M).all():
            candidates.append(Pose.from_rotation(tool, turned))
    # points all over the print, (30, 3) m in its axes
    sheet = target_picture(target.spec)
    height, width = np.array(sheet.grey.shape[:2]) / sheet.px_per_m
    x, y = np.meshgrid(np.linspace(0, width, 6), np.linspace(0, height, 5))
    outline = np.column_stack([x.ravel(), y.ravel(), np.zeros(30)])
    outline += np.append(np.asarray(sheet.origin_m, float)[:2], 0.0)
    facing = TOOL_DOWN.inv() * base_T_camera.rotation
    held = Pose.from_rotation(np.subtract(_HELD_M, facing.apply(outline.mean(axis=0))), facing)
    placed = [base_T_camera.inverse() @ pose @ held for pose in candidates]
    poses = [candidates[i] for i in most_telling(config.camera_model(), outline, placed, count)]
    if not config.moves:
        poses = [poses[i % len(poses)] if poses else Pose((0.0, 0.0, 0.0)) for i in range(count)]
    if len(poses) < FEWEST_VIEWS:
        raise InputError(
            f"the workspace of [arm.limits] holds {len(poses)} places where the whole of {target.spec} "
            "is in the picture: see position_m and look_at_m of [camera], or take a smaller board"
        )
    return poses


def collect_markers(station: Station, options: MarkersOptions) -> list[CalibrationResult]:
    """Take sixty pictures of the markers of an object at rest. Nothing moves."""
    station = station.with_objects(options.objects)
    config = station.config
    grasps = find_grasp_file(options.object_name, config.objects)
    refuse_undrawn(config, grasps)
    raw = station.raw("markers", config.require("camera").serial)
    with station.connection("Nothing moves; the camera takes pictures of an object.") as (bench, operator):
        operator.place(grasps.id, grasps.name)
        for number, frame in enumerate(capture_still(bench, bench.camera, _STILL_FRAMES, station.show)):
            write_picture(raw / f"{number:03d}.png", frame.image)
        station.note(f"{grasps.name}: {_STILL_FRAMES} pictures", 1, 1)
    camera = config.require("camera")
    of_bench = replace(
        options,
        ids=camera.marker_ids,
        dictionary=camera.marker_dictionary,
        pattern="*.png",
        serial=camera.serial,
    )
    return [_assess_pictures(raw, of_bench, station.camera())]


def compare_cameras(one: Path, other: Path) -> Differences:
    """Compare cameras, also those of other programs. Raises `CalibrationError` for a refused calibration."""
    lengths = np.linalg.norm(camera_difference_px(read_camera(one), read_camera(other)), axis=-1)
    rows, columns = lengths.shape
    middle = lengths[rows // 3 : -rows // 3, columns // 3 : -columns // 3]
    return {
        "rms_px": round(float(np.sqrt((lengths**2).mean())), 4),
        "middle_rms_px": round(float(np.sqrt((middle**2).mean())), 4),
        "worst_px": round(float(lengths.max()), 4),
    }


CAMERA = Kind("camera", CameraOptions, "views", solve_camera, collect_camera, compare_cameras)
MARKERS = Kind("markers", MarkersOptions, "objects", solve_markers, collect_markers)
