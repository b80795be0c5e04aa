"""`kinhec`: simulated pose streams with full truth, ours beside its own solvers and OpenCV's."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.pose_solve import PosePairResult, calibrate_pose_pairs
from calibration.hand_eye.samples import Setup
from calibration.poses import pose_from_matrix, pose_matrix
from calibration.time_offset import time_offset
from calibration.turning_rate import turning_rate
from drivers.errors import CalibrationError
from rig.benchmark.others.rows import Row, Say, installed, skipped

Array = NDArray[np.floating]
Errors = dict[str, list[tuple[float, float]]]
"""By solver, of each sequence that ours answers: degrees and mm; infinite where the solver gave none."""

PART = "kinhec"
_OPENCV = {
    "park": "PARK",
    "daniilidis": "DANIILIDIS",
    "horaud": "HORAUD",
    "tsai": "TSAI",
    "andreff": "ANDREFF",
}


def run_kinhec(folder: Path, say: Say) -> list[Row]:
    """Hand-eye and time offset on all sequences of its smoke tier, generated into a folder once."""
    version = installed("kinhec")
    if version is None:
        return [skipped(PART, "46 simulated sequences", "pip install kinhec")]
    import importlib

    kinhec: Any = importlib.import_module("kinhec")
    if not (folder / "sequences.parquet").is_file():
        say("kinhec generate --tier smoke: some minutes, once")
        folder.mkdir(parents=True, exist_ok=True)
        # its own notes go into the folder that it runs in
        with contextlib.chdir(folder):
            importlib.import_module("kinhec.cli").main(
                ["generate", "--tier", "smoke", "--out", str(folder.resolve()), "--workers", "1"]
            )
    errors, held, refused, wrong = {}, [], [], []
    offsets: list[Row] = []
    for sequence in _sequences(kinhec, folder):
        say(f"kinhec {sequence.id}")
        offsets += _offset(sequence, version)
        result = _ours(sequence)
        if result.pose is None or result.target is None:
            refused.append(f"{sequence.id}: {result.assessment.refusals[0].split(':')[0]}")
            continue
        inside = _holds(result, sequence)
        held.append(inside)
        if not inside and str(result.assessment.verdict) == "good":
            wrong.append(sequence.id)
        _score(errors, result, sequence)
    return [*_table(errors, version), *_coverage(held, refused, wrong, version), *offsets]


def _sequences(kinhec: Any, folder: Path) -> Iterator[Any]:
    manifest = kinhec.load_manifest(folder)
    for name in manifest.sequence_id:
        yield kinhec.load_sequence(folder, name, manifest)


def _pairs(sequence: Any) -> tuple[Array, Array]:
    """(N, 4, 4) base_T_tcp and camera_T_target of all frames seen, at the true offset (its protocol)."""
    robot, seen, valid = sequence.paired_measurements(None if sequence.synchronous else sequence.time_offset)
    return robot[valid], seen[valid]


def _ours(sequence: Any) -> PosePairResult:
    samples = [
        PoseSample(f"{i:05d}", pose_from_matrix(robot, "robot"), pose_from_matrix(seen, "target"))
        for i, (robot, seen) in enumerate(zip(*_pairs(sequence), strict=True))
    ]
    return calibrate_pose_pairs(samples, Setup.EYE_IN_HAND if sequence.eye_in_hand else Setup.EYE_TO_HAND)


def _wanted(result: PosePairResult, sequence: Any) -> tuple[Array, Array]:
    """What kinhec calls X, what is on the flange: (4, 4), and its (6, 6) covariance."""
    pose, covariance = (
        (result.pose, result.covariance)
        if sequence.eye_in_hand
        else (result.target, result.target_covariance)
    )
    if pose is None or covariance is None:
        raise CalibrationError("hand-eye: no answer")
    return pose_matrix(pose), covariance


def _holds(result: PosePairResult, sequence: Any) -> bool:
    found, covariance = _wanted(result, sequence)
    turn = Rotation.from_matrix(found[:3, :3].T @ sequence.X[:3, :3]).as_rotvec()
    error = np.concatenate([turn, sequence.X[:3, 3] - found[:3, 3]])
    bound = 6 * f_distribution.ppf(0.95, 6, max(result.samples - 1, 1))
    return bool(error @ np.linalg.solve(covariance, error) <= bound)


def _score(errors: Errors, result: PosePairResult, sequence: Any) -> None:
    import importlib

    benchmark: Any = importlib.import_module("kinhec.benchmark")
    errors.setdefault("ours", []).append(_error(_wanted(result, sequence)[0], sequence))
    data = benchmark._keyframe_data(sequence, None if sequence.synchronous else sequence.time_offset)  # noqa: SLF001
    for name, solver in benchmark.SOLVERS.items():
        errors.setdefault(name, []).append(
            _attempt(lambda s=solver: s(data, np.random.default_rng(0))["X"], sequence)
        )
    for name in _OPENCV:
        errors.setdefault(f"OpenCV {name}", []).append(
            _attempt(lambda n=name: _opencv(n, sequence), sequence)
        )


def _opencv(name: str, sequence: Any) -> Array:
    """OpenCV's answer to the same poses: what is on the flange."""
    robot, seen = _pairs(sequence)
    keep = np.linspace(0, len(robot) - 1, min(len(robot), 60)).astype(int)
    hand, eye = (
        (robot[keep], seen[keep]) if sequence.eye_in_hand else (robot[keep], np.linalg.inv(seen[keep]))
    )
    turn, move = cv2.calibrateHandEye(
        list(hand[:, :3, :3]), list(hand[:, :3, 3]), list(eye[:, :3, :3]), list(eye[:, :3, 3]),
        method=getattr(cv2, f"CALIB_HAND_EYE_{_OPENCV[name]}"),
    )  # fmt: skip
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn, np.ravel(move)
    return found


def _attempt(solve: Any, sequence: Any) -> tuple[float, float]:
    try:
        return _error(np.asarray(solve(), np.float64), sequence)
    except (ValueError, ArithmeticError, RuntimeError, cv2.error):
        return np.inf, np.inf


def _error(found: Array, sequence: Any) -> tuple[float, float]:
    """Degrees and mm; infinite where it is no pose."""
    if not np.isfinite(found).all():
        return np.inf, np.inf
    turn = np.degrees(np.arccos(np.clip((np.trace(found[:3, :3].T @ sequence.X[:3, :3]) - 1) / 2, -1, 1)))
    return float(turn), 1e3 * float(np.linalg.norm(found[:3, 3] - sequence.X[:3, 3]))


def _table(errors: Errors, version: str) -> list[Row]:
    """A row for each solver: median and 95th percentile, ours beside."""
    figures = {name: _figures(values) for name, values in errors.items()}
    ours = figures.pop("ours")
    rows = []
    for name, theirs in figures.items():
        better = all(o <= t * 1.02 for o, t in zip(ours, theirs, strict=True))
        rows.append(
            Row(
                PART, f"hand-eye, {len(errors['ours'])} sequences: {name}", version,
                "median deg, mm; 95 % deg, mm", _shown(ours), _shown(theirs), better,
            )
        )  # fmt: skip
    return rows


def _figures(values: list[tuple[float, float]]) -> tuple[float, float, float, float]:
    turn, move = np.array(values).T
    return tuple(float(v) for part in (50, 95) for v in (_percentile(turn, part), _percentile(move, part)))  # type: ignore[return-value]


def _percentile(values: Array, share: float) -> float:
    """Of values that may be infinite: the next larger one, not a mean with it."""
    return float(np.percentile(values, share, method="higher"))


def _shown(figures: tuple[float, float, float, float]) -> str:
    return f"{figures[0]:.3f}, {figures[1]:.2f}; {figures[2]:.2f}, {figures[3]:.1f}"


def _coverage(held: list[bool], refused: list[str], wrong: list[str], version: str) -> list[Row]:
    share = float(np.mean(held))
    return [
        Row(
            PART, "95 % region holds the truth", version, f"{sum(held)} of {len(held)}", f"{share:.1%}",
            "90 to 98 % asked", 0.90 <= share <= 0.98,
        ),
        Row(
            PART, "called good, and off beyond the region", version, ", ".join(wrong) or "none",
            str(len(wrong)), "0 asked", not wrong,
        ),
        Row(PART, f"refused: {len(refused)}", version, "; ".join(refused)),
    ]  # fmt: skip


def _offset(sequence: Any, version: str) -> list[Row]:
    """Our time offset of a sequence whose clocks differ, beside kinhec's and the truth."""
    if sequence.synchronous:
        return []
    import importlib

    solvers: Any = importlib.import_module("kinhec.solvers")
    robot, camera, seen = sequence.robot, sequence.camera, sequence.camera.has_measurement
    streams = [
        turning_rate(
            np.round(times * 1e9).astype(np.int64), Rotation.from_matrix(poses[:, :3, :3]).as_quat(), name
        )
        for name, times, poses in (
            ("robot", robot.t, robot.T_base_ee_meas),
            ("camera", camera.t[seen], camera.T_cam_target_meas[seen]),
        )
    ]
    found = time_offset(streams[0], streams[1])
    theirs, _ = solvers.estimate_time_offset(
        robot.t, robot.T_base_ee_meas, camera.t, camera.T_cam_target_meas
    )
    truth = 1e3 * sequence.time_offset
    if found.offset_s is None or found.sigma_s is None:
        said = f"truth {truth:.1f} ms; {found.assessment}"
        return [Row(PART, f"time offset, {sequence.id}", version, said, "", f"{1e3 * theirs:.2f} ms")]
    ours = -1e3 * found.offset_s
    return [
        Row(
            PART, f"time offset, {sequence.id}", version, f"truth {truth:.1f} ms",
            f"{ours:.2f} ± {1e3 * found.sigma_s:.2f} ms", f"{1e3 * theirs:.2f} ms",
            abs(ours - truth) <= max(abs(1e3 * theirs - truth), 2e3 * found.sigma_s),
        )
    ]  # fmt: skip
