"""`rig calibrate hand-eye`: the pose of a camera, from pictures or poses of a target at known robot poses.

On a bench poses are chosen and visited, the samples are stored as files, and then solved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.files import read_camera
from calibration.camera.model import CameraModel
from calibration.hand_eye.pose_pairs import PoseSample, calibrate_pose_pairs
from calibration.hand_eye.refine import LEAST_GAP, LEAST_RATIO, LEAST_TURN_DEG
from calibration.hand_eye.solve import HandEyeResult, HandEyeSample, Setup, calibrate_hand_eye, next_pose
from calibration.poses import pose_from_quaternion
from calibration.store import read_yaml
from calibration.targets.boards import Target, View, parse_target
from calibration.verdict import Rejected
from drivers.errors import CalibrationError, InputError, plural
from drivers.images import read_image
from drivers.types import Pose
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.calibrate import charts
from rig.calibrate.bench import Station, visits
from rig.calibrate.charts import Picture, thumbnails
from rig.calibrate.kind import (
    CameraFile,
    Differences,
    Kind,
    PosesOption,
    Samples,
    SerialOption,
    TargetOption,
    distance_mm,
)
from rig.calibrate.result import DEGREES, MM, CalibrationResult, Figure
from rig.calibrate.samples import picture_files, pose_row, read_poses, write_picture, write_poses
from rig.config import BenchConfig
from rig.declared import option

FRAMES = {Setup.EYE_TO_HAND: ("base", "camera", "tcp"), Setup.EYE_IN_HAND: ("tcp", "camera", "base")}
"""Parent and child frame of the answer, and the parent of the target, by setup."""
TARGETS = "targets.csv"
FIRST_POSES = 6
"""Visited as drawn; from then on each next pose is the most informative one."""
_NOISE = {
    "noise_robot_turn_rad": "noise of the robot's orientation",
    "noise_robot_m": "noise of the robot's position",
    "noise_tilt_rad": "noise of the target's tilt",
    "noise_turn_rad": "noise of the target's rotation in the picture",
    "noise_across_m": "noise of the target's position across the line of sight",
    "noise_depth_m": "noise of the target's distance",
}
"""Labels of the estimated noise, in the order of `HandEyeResult.sigmas`."""
_ORDER = "rotation vector about the child's axes (rad), translation in the parent (m)"
_CANDIDATES = 60
_WORKSPACE_M = 0.15
"""Half the side of the cube around the target in which two answers are compared."""
_MOUNTED = {
    Setup.EYE_TO_HAND: ("tool", "on the tool, facing the camera"),
    Setup.EYE_IN_HAND: (
        "bench",
        "on the table's mark, face up; the camera is on the tool, looking past the fingers",
    ),
}


@dataclass(frozen=True)
class HandEyeOptions:
    """Calibrate the pose of the camera: base_T_camera if it is fixed, tcp_T_camera if it is on the tool.

    On a bench the arm visits --poses poses. Each is chosen to reduce the uncertainty most, and each picture
    is taken at rest. For eye-to-hand, fix the target rigidly to the tool. For eye-in-hand, put the target on
    the mark of the table; the camera on the tool looks past the fingers. The intrinsics are read from
    calibrations/ if they are there.

    The folder of --from holds pictures <id>.png (or .jpg ...) and poses.csv. Its columns are id, x_m, y_m,
    z_m and qx, qy, qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them), the pose base_T_tcp of each
    picture. Pictures and poses are paired by id, not by order. The resulting quaternion is in the order xyzw.

    The folder may hold targets.csv instead of pictures: the poses camera_T_target that another detector
    found, in the same columns. Then --camera is not needed. The noise of arm and detector is estimated from
    the pairs of poses.

    Examples:
      rig calibrate hand-eye --from samples --camera camera.yaml --target marker:60:DICT_4X4_50:0
      rig calibrate hand-eye --bench fake --poses 15
      rig calibrate hand-eye --bench fake --setup eye-in-hand
    """

    target: TargetOption = "marker:60:DICT_4X4_50:0"
    camera_file: CameraFile = None
    setup: Setup = option(Setup.EYE_TO_HAND, "Fixed camera, or camera on the tool.")
    serial: SerialOption = "unknown"
    poses: PosesOption = 20


def solve_hand_eye(samples: Samples, options: HandEyeOptions) -> CalibrationResult:
    """Solve from pictures of a target, or from its poses if the folder holds them.

    Pictures `<id>.png` are paired with the rows of poses.csv by id. Raises `InputError`.
    """
    folder, serial, target = samples.folder, options.serial, parse_target(options.target)
    if (folder / TARGETS).is_file():
        return _solve_poses(folder, serial, options.setup)
    if options.camera_file is None:
        raise InputError("hand-eye needs the camera's intrinsics: give --camera FILE (rig calibrate camera)")
    camera = read_camera(options.camera_file, None if serial == "unknown" else serial)
    poses, rejected = read_poses(folder / "poses.csv", "tcp")
    paired: list[HandEyeSample] = []
    pictures: dict[str, Path] = {}
    views: dict[str, View | str] = {}
    for path in picture_files(folder):
        name = path.stem
        pictures[name] = path
        if name not in poses:
            if name not in {r.id for r in rejected}:
                rejected.append(Rejected(name, "no pose of this id in poses.csv"))
            continue
        view = views[name] = target.find(read_image(path, grey=True), name)
        if isinstance(view, str):
            rejected.append(Rejected(name, view))
        else:
            paired.append(HandEyeSample(name, poses[name], view))
    rejected += [Rejected(name, "no picture of this id") for name in poses.keys() - pictures.keys()]
    result = _solve_views(paired, rejected, folder, camera, options)
    return replace(result, thumbnails=thumbnails(result.rejected, pictures, views))


def _solve_poses(folder: Path, serial: str, setup: Setup) -> CalibrationResult:
    """Pair `poses.csv` (base_T_tcp) and `targets.csv` (camera_T_target) by id, and solve."""
    files = [folder / "poses.csv", folder / TARGETS]
    (robot, rejected), (seen, also) = read_poses(files[0], "tcp"), read_poses(files[1])
    rejected = rejected + also
    rejected += [Rejected(name, "no pose of the target of this id") for name in robot.keys() - seen.keys()]
    rejected += [Rejected(name, "no robot pose of this id") for name in seen.keys() - robot.keys()]
    found = calibrate_pose_pairs(
        [PoseSample(name, robot[name], seen[name]) for name in robot if name in seen], setup
    )
    return _result(found, serial, folder, rejected, robot, files)


def _solve_views(
    samples: Sequence[HandEyeSample],
    rejected: Sequence[Rejected],
    folder: Path,
    camera: CameraModel,
    options: HandEyeOptions,
) -> CalibrationResult:
    """Solve, and draw the figures of the page. folder: of the pictures and poses.csv."""
    found = calibrate_hand_eye(samples, camera, options.setup)
    robot = {sample.id: sample.base_T_tcp for sample in samples}
    pictures = picture_files(folder)
    by_id = {path.stem: path for path in pictures}
    drawn = _pictures(found, [sample.view for sample in samples], camera, by_id)
    files = [*pictures, folder / "poses.csv"]
    seen = parse_target(options.target).spec
    return _result(found, options.serial, folder, rejected, robot, files, seen, drawn)


def _result(
    found: HandEyeResult, serial: str, folder: Path, rejected: Sequence[Rejected], robot: Mapping[str, Pose],
    files: Sequence[Path], seen: str = "", pictures: Sequence[Picture] = (),
) -> CalibrationResult:  # fmt: skip
    """Return the calibration with all poses in 3D. robot: base_T_tcp by sample. seen: as in `_figures`."""
    setup, pose, target = found.setup, found.pose, found.target
    layout: dict[str, object] = {}
    if pose is not None and target is not None:
        parent, child, holder = FRAMES[setup]
        layout = {"setup": str(setup), **_transform(parent, child, pose)}
        layout["target"] = _transform(holder, "target", target)
        moving, used = setup is Setup.EYE_IN_HAND, [robot[name] for name in found.used]
        groups = {
            "TCP": used,
            "camera": [at @ pose for at in used] if moving else [pose],
            "target": [target] if moving else [at @ target for at in used],
            "base": [Pose((0.0, 0.0, 0.0))],
        }
        text = "Axes of each frame, in the robot's base frame; the longest is z: the camera looks along it."
        pictures = [charts.poses(text, groups), *pictures]
    return CalibrationResult(
        "hand-eye", {"camera": serial}, layout, found.assessment, _figures(found, seen),
        source=str(folder), used=len(found.used), rejected=[*rejected, *found.rejected], files=files,
        pictures=pictures,
    )  # fmt: skip


def _transform(parent: str, child: str, pose: Pose) -> dict[str, object]:
    return {
        "parent_frame": parent,
        "child_frame": child,
        "translation_m": pose.position_m,
        "quaternion_xyzw": pose.quaternion_xyzw,
    }


def _figures(result: HandEyeResult, seen: str) -> list[Figure]:
    """Return the figures of an answer. seen: the target in the pictures; "" for pairs of poses."""
    motion, pose, (parent, child, _) = result.motion, result.pose, FRAMES[result.setup]
    figures = [Figure("target", seen)] if seen else []
    if motion is not None and seen:
        figures += [
            Figure("max_angle_deg", motion.max_angle_deg,
                   f"largest rotation between poses (limit {LEAST_TURN_DEG:g})", ".0f", "degrees"),
            Figure("translation_ratio", motion.translation_ratio,
                   f"rotation about different axes (limit {LEAST_RATIO:g})", ".2f"),
            Figure("rotation_gap", motion.rotation_gap, f"gap of the rotation (limit {LEAST_GAP:g})", ".2g"),
        ]  # fmt: skip
    if pose is None or result.covariance is None:
        return figures
    sigma, name = np.sqrt(np.diag(result.covariance)), f"{parent}_T_{child}"
    figures = [
        Figure("", pose.position_m, f"{name}, position x, y, z", ".5f", "m", sigma=sigma[3:]),
        Figure("", pose.quaternion_xyzw, f"{name}, quaternion x, y, z, w", ".6f"),
        Figure("", sigma[:3], f"{name}, one sigma of the rotation about x, y, z", *DEGREES),
        Figure("covariance_order", _ORDER),
        Figure("covariance", result.covariance),
        *figures,
    ]
    if result.sigmas is not None:
        figures += [
            Figure(key, value, label, *(MM if key.endswith("_m") else DEGREES))
            for (key, label), value in zip(_NOISE.items(), result.sigmas.tolist(), strict=True)
        ]
    if result.held_out_px is not None and result.from_camera is not None and result.refined:
        part = np.sqrt(np.diag(result.from_camera))
        turn_rad, move_m = float(np.linalg.norm(part[:3])), float(np.linalg.norm(part[3:]))
        held_out_px = float(np.sqrt((result.held_out_px**2).mean()))
        figures += [
            Figure("covariance_from_camera", result.from_camera),
            Figure("", move_m, f"{name}, sigma of the position due to the camera", *MM),
            Figure("", turn_rad, f"{name}, sigma of the rotation due to the camera", *DEGREES),
            Figure("rms_px", result.refined.rms_px, "error of the samples used", ".2f", "px"),
            Figure("held_out_rms_px", held_out_px, "error of samples left out", ".2f", "px"),
        ]
    return figures


def _pictures(
    result: HandEyeResult, views: list[View], camera: CameraModel, files: Mapping[str, Path]
) -> list[Picture]:
    """Draw the residuals, the worst sample's on its picture, and where the target was seen."""
    pictures, problem, refined = [], result.problem, result.refined
    if problem is not None and refined is not None:
        worst = int(np.argmax(refined.sample_rms_px(problem)))
        name, own = problem.ids[worst], problem.owner == worst
        text = "each arrow points from the projection of a target point, as calibrated, to its detection."
        of_all = (
            "Arrows of one sample that agree show a robot pose or a picture that does not fit the others."
        )
        pictures += [
            charts.residuals(
                "Residuals of the worst sample", f"{name}: {text}", problem.seen_px[own],
                -refined.missed_px[own], camera.size, read_image(files[name], grey=True),
            ),
            charts.residuals(
                "Residuals of all samples", of_all, problem.seen_px, -refined.missed_px, camera.size
            ),
        ]  # fmt: skip
    if result.sample_px:
        limit = 3.0 * float(np.median(list(result.sample_px.values())))
        text = "Rms residual of each sample. Dashed: three times the median."
        pictures.append(charts.bars("Error per sample", text, result.sample_px, "rms, px", limit))
    if result.held_out_px is not None:
        held = dict(zip(result.used, result.held_out_px.tolist(), strict=True))
        text = "Rms residual of each sample for the answer from all others."
        pictures.append(charts.bars("Error of samples left out", text, held, "rms, px"))
    if views and result.motion is not None:
        points = np.vstack([v.image_px for v in views])
        places = {"points": (points[:, 0], camera.size[1] - points[:, 1])}
        text = "Its points in all samples."
        pictures.append(charts.curves("Where the target was seen", text, places, "x, px", "up, px", "."))
    return pictures


def collect_hand_eye(station: Station, options: HandEyeOptions) -> list[CalibrationResult]:
    """Visit poses on a bench and solve. Raw pictures and poses.csv stay beside the result.

    The target is firm on the tool (eye-to-hand), or firm on the bench with the camera on the tool
    (eye-in-hand). Raises `OperatorStopError` unless the operator agrees to the motion,
    `DeviceError`, `InputError`.
    """
    config, target = station.config, parse_target(options.target)
    mount, where = _MOUNTED[options.setup]
    poses = facing_poses(config, station.seed) if mount == "tool" else looking_poses(config, station.seed)
    camera = station.camera()
    session = _Session(target, camera, options.setup, poses, options.poses, station)
    around = config.require("camera").look_at_m if mount == "tool" else config.require("table").position_m
    with station.connection(
        f"The arm will visit {plural(options.poses, 'pose')} around {around} m at up to {SPEED_M_S} m/s, "
        f"tilted by up to 35 degrees, with the target {target.spec} {where}; it chooses from these "
        "places, and leaves out what would be refused.",
        motions=visits([(f"{i:03d}", pose) for i, pose in enumerate(poses, start=1)]),
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        operator.place(f"{target.spec}@{mount}", f"target {target.spec}, firm {where}")
        capture_hand_eye(bench, session.next, session.keep, session.skip)
    write_poses(session.raw, session.rows, "tcp")
    of_bench = replace(options, serial=config.require("camera").serial)
    result = _solve_views(session.samples, session.rejected, session.raw, camera, of_bench)
    return [replace(result, simulated=config.simulated)]


def facing_poses(
    config: BenchConfig, seed: int, reach_m: tuple[float, float, float] = (0.08, 0.08, 0.08)
) -> list[Pose]:
    """Return tool poses near the point where the camera is aimed, turned by 10 to 35 degrees, any axis."""
    rng = np.random.default_rng((seed, 30))
    middle = np.add(config.require("camera").look_at_m, (0.0, 0.0, 0.08))
    poses = []
    for _ in range(_CANDIDATES):
        axis = rng.normal(0, 1, 3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(10, 35)))
        poses.append(Pose.from_rotation(middle + rng.uniform(-1, 1, 3) * reach_m, turn * TOOL_DOWN))
    return poses


def looking_poses(config: BenchConfig, seed: int) -> list[Pose]:
    """Return poses from which a camera that looks along the tool sees the table's mark.

    From 0.26 to 0.36 m, tilted by up to 28 degrees any way, turned by up to 50 about the tool's axis.
    """
    rng = np.random.default_rng((seed, 32))
    poses = []
    for _ in range(_CANDIDATES):
        way = rng.uniform(0.0, 2.0 * np.pi)
        tilt = Rotation.from_rotvec(
            np.radians(rng.uniform(5, 28)) * np.array([np.cos(way), np.sin(way), 0.0])
        )
        turn = tilt * TOOL_DOWN * Rotation.from_euler("z", rng.uniform(-50, 50), degrees=True)
        aim = np.add(config.require("table").position_m, (*rng.uniform(-0.03, 0.03, 2), 0.0))
        poses.append(Pose.from_rotation(aim - turn.apply([0.0, 0.0, rng.uniform(0.26, 0.36)]), turn))
    return poses


class _Session:
    def __init__(
        self, target: Target, camera: CameraModel, setup: Setup, candidates: list[Pose], count: int,
        station: Station,
    ) -> None:  # fmt: skip
        self._target, self._camera, self._setup = target, camera, setup
        self._left, self._count, self._station = candidates, count, station
        self.raw: Path = station.raw("hand-eye")
        self.samples: list[HandEyeSample] = []
        self.rejected: list[Rejected] = []
        self.rows: list[str] = []
        self._visited = 0

    def next(self) -> tuple[str, Pose] | None:
        """Return the next pose: first those as drawn, then the one that lowers the predicted sigma most."""
        if len(self.samples) >= self._count or not self._left:
            return None
        self._visited += 1
        choice = 0
        if len(self.samples) >= FIRST_POSES:
            result = calibrate_hand_eye(self.samples, self._camera, self._setup)
            best = None if result.pose is None else next_pose(result, self._camera, self._left)
            choice = 0 if best is None else best[1]
        return f"{self._visited:03d}", self._left.pop(choice)

    def keep(self, capture: HandEyeCapture) -> None:
        grey = np.asarray(cv2.cvtColor(capture.frame.image, cv2.COLOR_RGB2GRAY), np.uint8)
        write_picture(self.raw / f"{capture.id}.png", grey)
        if self._station.show is not None:
            self._station.show(capture.frame)
        self.rows.append(pose_row(capture.id, capture.base_T_tcp))
        view = self._target.find(grey, capture.id)
        if isinstance(view, View):
            self.samples.append(HandEyeSample(capture.id, capture.base_T_tcp, view))
            kept = len(self.samples)
            self._station.note(f"{capture.id}: kept, {kept} of {self._count}", kept, self._count)
        else:
            self.skip(capture.id, view)

    def skip(self, name: str, reason: str) -> None:
        self.rejected.append(Rejected(name, reason))
        self._station.leave_out(name, reason)


def compare_hand_eye(one_file: Path, other_file: Path) -> Differences:
    """Compare the positions that the two answers give to points in the workspace.

    Raises `CalibrationError` for a fixed camera and one on the tool.
    """
    one, other = read_yaml(one_file), read_yaml(other_file)
    if one.get("setup") != other.get("setup"):
        raise CalibrationError(
            f"one is {one.get('setup')}, the other {other.get('setup')}: nothing to compare"
        )
    nodes = [one, other, *([one["target"]] if one.get("setup") == "eye-in-hand" else [])]
    x, y, *target = (
        pose_from_quaternion(node["translation_m"], node["quaternion_xyzw"], "calibration file")
        for node in nodes
    )
    ahead = (x.inverse() @ target[0]).position_m if target else (0.0, 0.0, 0.7)
    corners = ahead + _WORKSPACE_M * np.array(list(product((-1, 1), repeat=3)))
    apart = x.rotation.apply(corners) + x.position_m - (y.rotation.apply(corners) + y.position_m)
    return {
        "turn_deg": round(float(np.degrees((x.rotation.inv() * y.rotation).magnitude())), 4),
        "move_mm": distance_mm(one, other),
        "worst_in_workspace_mm": round(1e3 * float(np.linalg.norm(apart, axis=1).max()), 3),
    }


HAND_EYE = Kind("hand-eye", HandEyeOptions, "poses", solve_hand_eye, collect_hand_eye, compare_hand_eye)
