"""Real hand-eye pictures and pose streams that others published: ours beside OpenCV's, by held-out data."""

import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.checks import assess_camera
from calibration.camera.intrinsics import calibrate_camera
from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.hand_eye.closed_form import Transforms, target_from_x
from calibration.hand_eye.refine import linearised
from calibration.hand_eye.samples import HandEyeSample, Setup, make_problem
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.hand_eye.target_pose import target_poses
from calibration.poses import pose_from_quaternion
from calibration.targets.boards import parse_target
from calibration.targets.views import View
from calibration.time_offset import TimedSignal, time_offset
from calibration.turning_rate import turning_rate
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from drivers.images import read_image
from rig.benchmark.others.rows import Row, Say, clone_of, commit_of, how_to_clone, skipped

Array = NDArray[np.floating]

PART = "real sets"
_BOARDS = "eirikwha/hand_eye_calibration"
_STREAMS = "ethz-asl/hand_eye_calibration"
_HALVES = 10
_METHODS = {"Park": cv2.CALIB_HAND_EYE_PARK, "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS}
_PAIRS = {
    "1_falcon": ("falcon_vicon", "imu_odom"), "3_falcon": ("falcon_vicon", "imu_odom"),
    "4_falcon": ("falcon_vicon", "imu_odom"), "5_falcon": ("falcon_vicon", "imu_odom"),
    "prime_sense_color_w_vicon_1": ("vicon_prime", "camera_rgb"),
    "prime_sense_color_w_vicon_2": ("vicon_prime", "camera_rgb"),
    "robot_arm_w_color_camera_real": ("hinge", "target_ir"),
    "robot_arm_w_color_camera_sim": ("hand", "camera"),
    "tango_triplet_easy": ("CALIGULA", "MARS"), "tango_triplet_hard": ("CALIGULA", "MARS"),
}  # fmt: skip
"""Two streams of one moving body in each set, by what their names hold."""


def run_boards(clones: Path | None, say: Say) -> list[Row]:
    """A board in a gripper before a fixed camera: who is right, and mistakes that have to be refused."""
    clone = clone_of(_BOARDS, clones)
    if clone is None:
        return [skipped(PART, _BOARDS, how_to_clone(_BOARDS))]
    version = commit_of(clone)
    say(f"{_BOARDS}: corners of 40 pictures")
    samples = _samples(clone / "data" / "calib080419", "chessboard:9x7:10")
    camera = _camera([s.view for s in samples])
    found = calibrate_hand_eye(samples, camera, Setup.EYE_TO_HAND)
    if found.spread is None:
        return [Row(PART, f"{_BOARDS} calib080419", version, f"refused: {found.assessment}", met=False)]
    mm = 1e3 * np.array([np.linalg.norm(found.spread.sigma_m), np.linalg.norm(found.spread.camera_sigma_m)])
    rows = [
        Row(
            PART, f"{_BOARDS} calib080419: sigma and verdict", version, str(found.assessment.verdict),
            f"{mm[0]:.2f} mm, of it by the camera {mm[1]:.2f} mm", "",
            found.assessment.verdict is Verdict.WEAK and "camera's intrinsics" in str(found.assessment),
        )
    ]  # fmt: skip
    exact = replace(camera, uncertainty=None)
    rows += [_beside(name, samples, exact, version) for name in _METHODS]
    turned = [replace(s, base_T_tcp=s.base_T_tcp.inverse()) for s in samples]
    robots = [s.base_T_tcp for s in samples]
    shifted = [replace(s, base_T_tcp=p) for s, p in zip(samples, robots[1:] + robots[:1], strict=True)]
    rows += [
        _refused("poses inverted", turned, camera, version),
        _refused("shifted by one", shifted, camera, version),
    ]
    bad = _samples(clone / "data" / "calib_110619_chessboard_small", "chessboard:8x6:20")
    return [*rows, _refused("calib_110619, the bad set", bad, _camera([s.view for s in bad]), version)]


def _samples(folder: Path, target: str) -> list[HandEyeSample]:
    board = parse_target(target)
    samples = []
    for path in sorted((folder / "img").glob("*.png")):
        row = folder / "pose" / (path.stem.replace("img", "pose") + ".yml")
        view = board.find(read_image(path, grey=True), path.stem)
        if isinstance(view, View) and row.is_file():
            numbers = np.fromstring(row.read_text().split("[")[1].split("]")[0], sep=",")
            pose = pose_from_quaternion(numbers[:3], numbers[3:], path.stem)
            samples.append(HandEyeSample(path.stem, pose, view))
    return samples


def _camera(views: Sequence[View]) -> CameraModel:
    fit = calibrate_camera(views)
    known = CameraUncertainty(fit.fit.lens.free, fit.covariance, assess_camera(fit).doubts)
    return replace(fit.fit.camera, uncertainty=known)


def _beside(name: str, samples: list[HandEyeSample], camera: CameraModel, version: str) -> Row:
    """Ours and OpenCV's on halves of the data: corners of the other half missed, and answers apart."""
    rng = np.random.default_rng(0)
    missed, apart = {"ours": [], name: []}, {"ours": [], name: []}
    solvers: dict[str, Callable[[list[HandEyeSample]], Transforms | None]] = {
        "ours": lambda part: _ours(part, camera), name: lambda part: _opencv(_METHODS[name], part, camera),
    }  # fmt: skip
    for _ in range(_HALVES):
        order = rng.permutation(len(samples))
        halves = [[samples[i] for i in part] for part in np.array_split(order, 2)]
        for who, solve in solvers.items():
            one, other = (solve(half) for half in halves)
            if one is None or other is None:
                raise CalibrationError(f"hand-eye: {who} gave no answer for half of the data")
            missed[who] += [_missed_px(one, halves[1], camera), _missed_px(other, halves[0], camera)]
            apart[who].append(1e3 * float(np.linalg.norm(one.x_t - other.x_t)))
    px = {who: float(np.sqrt(np.mean(np.square(values)))) for who, values in missed.items()}
    mm = {who: float(np.median(values)) for who, values in apart.items()}
    return Row(
        PART, f"{_BOARDS} calib080419: ours and OpenCV's {name}", version,
        "corners of the other half missed; answers of halves apart",
        f"{px['ours']:.2f} px, {mm['ours']:.1f} mm",
        f"{px[name]:.2f} px, {mm[name]:.1f} mm", px["ours"] <= px[name] and mm["ours"] <= mm[name],
    )  # fmt: skip


def _ours(part: list[HandEyeSample], camera: CameraModel) -> Transforms | None:
    result = calibrate_hand_eye(part, camera, Setup.EYE_TO_HAND)
    return None if result.refined is None else result.refined.transforms


def _opencv(method: int, part: list[HandEyeSample], camera: CameraModel) -> Transforms:
    """OpenCV's answer to the target's poses (the better of the two that each picture allows)."""
    problem = make_problem(part, camera, Setup.EYE_TO_HAND)
    turns, moves = target_poses(problem)
    back = problem.a_R.transpose(0, 2, 1)
    away = -(back @ problem.a_t[..., None])
    turn, move = cv2.calibrateHandEye(
        list(back), list(away), list(turns[:, 0]), list(moves[:, 0, :, None]), method=method
    )
    x_R, x_t = np.asarray(turn, np.float64), np.asarray(move, np.float64).ravel()  # noqa: N806
    return target_from_x(x_R, x_t, problem.a_R, problem.a_t, turns[:, 0], moves[:, 0])


def _missed_px(at: Transforms, part: list[HandEyeSample], camera: CameraModel) -> float:
    missed, _ = linearised(make_problem(part, camera, Setup.EYE_TO_HAND), at)
    return float(np.sqrt((missed**2).sum(axis=1).mean()))


def _refused(what: str, samples: list[HandEyeSample], camera: CameraModel, version: str) -> Row:
    result: HandEyeResult = calibrate_hand_eye(samples, camera, Setup.EYE_TO_HAND)
    return Row(PART, f"{_BOARDS}: {what}", version, str(result.assessment), met=result.pose is None)


def run_streams(clones: Path | None, say: Say) -> list[Row]:
    """Pose streams on two clocks: our offset beside the best correlation of the rates."""
    clone = clone_of(_STREAMS, clones)
    if clone is None:
        return [skipped(PART, _STREAMS, how_to_clone(_STREAMS))]
    return [_offset(clone, name, say) for name in _PAIRS]


def _offset(clone: Path, name: str, say: Say) -> Row:
    say(f"{_STREAMS} {name}")
    version, what = commit_of(clone), f"{_STREAMS} {name}: offset"
    try:
        first, second = _rates(clone / "datasets" / f"{name}.zip", _PAIRS[name])
        search_s = 5.0 if name.startswith("tango") else 1.0
        found = time_offset(first, second, search_s)
    except CalibrationError as error:
        return Row(PART, what, version, f"refused: {error}")
    at_ms, alike = _correlated(first, second, search_s)
    theirs = f"{at_ms:.0f} ms, correlation {alike:.2f}"
    if found.offset_s is None or found.sigma_s is None:
        return Row(PART, what, version, f"refused: {found.assessment.refusals[0]}", "", theirs)
    ours = 1e3 * found.offset_s
    return Row(
        PART, what, version, str(found.assessment.verdict), f"{ours:.1f} ± {1e3 * found.sigma_s:.1f} ms",
        theirs, abs(ours - at_ms) <= 5.0,
    )  # fmt: skip


def _rates(path: Path, names: tuple[str, str]) -> tuple[TimedSignal, TimedSignal]:
    """How fast both bodies turn; clocks that lie apart by minutes begin together."""
    with zipfile.ZipFile(path) as archive:
        files = {name: next(f for f in sorted(archive.namelist()) if name in Path(f).name) for name in names}
        tables = [np.loadtxt(io.BytesIO(archive.read(files[name])), delimiter=",") for name in names]
    starts = [table[:, 0].min() for table in tables]
    if abs(starts[0] - starts[1]) < 30.0:
        starts = [starts[0], starts[0]]
    rates = []
    for name, table, start in zip(names, tables, starts, strict=True):
        turns = table[:, 4:8] / np.linalg.norm(table[:, 4:8], axis=1)[:, None]
        rates.append(turning_rate(np.round((table[:, 0] - start) * 1e9).astype(np.int64), turns, name))
    return rates[0], rates[1]


def _correlated(first: TimedSignal, second: TimedSignal, search_s: float) -> tuple[float, float]:
    """The offset, ms, at which both rates correlate best on a grid of 1 ms, and the correlation there."""
    one, other = first.time_ns / 1e9, second.time_ns / 1e9
    grid = np.arange(max(one[0], other[0]) + search_s, min(one[-1], other[-1]) - search_s, 1e-3)
    seen = np.interp(grid, other, second.values)
    steps = np.arange(-search_s, search_s, 1e-3)
    alike = [float(np.corrcoef(np.interp(grid + step, one, first.values), seen)[0, 1]) for step in steps]
    best = int(np.nanargmax(alike))
    return 1e3 * float(steps[best]), alike[best]
