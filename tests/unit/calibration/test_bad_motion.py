"""Bad motion and data for the calibrations: each case is refused with the right reason or answered right.

Every other outcome is wrong: a crash, a warning, a NaN, an error above the tolerance. The tolerance is the
calibration's own uncertainty if it called its answer weak. Cases without random draws: `test_bad_input.py`.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.gripper import calibrate_pivot
from calibration.hand_eye.solve import HandEyeSample, Setup, calibrate_hand_eye
from calibration.time_offset import TimedSignal, time_offset
from drivers.errors import RigError
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import CAMERA, Truth, general_scene, wiggle_scene
from support.marks import long
from support.motions import motion_scene, pivot_scene

Random = np.random.Generator
Answer = str | tuple[float, float]
"""The reason of a refusal; or the error of an answer, and the largest error that counts as right."""
_COUNT = 20
"""Hand-eye samples of a case."""
_OFFSET_S, _ALLOWED_S = 0.0473, 2e-3


def motion(rng: Random, kind: str) -> tuple[Truth, list[HandEyeSample]]:
    """Draw samples of a motion that constrains a hand-eye pose poorly. kind: a key of `turns` below."""
    moves = rng.uniform(-0.1, 0.1, (_COUNT, 3))
    angles = np.radians(rng.uniform(-45, 45, _COUNT))[:, None]
    axis = np.array([0.0, 0.6, 0.8])
    any_axis = rng.normal(0, 1, (_COUNT, 3))
    any_axis /= np.linalg.norm(any_axis, axis=1, keepdims=True)
    near = axis + rng.normal(0, np.radians(3.0), (_COUNT, 3))
    turns = {
        "near-parallel": angles * near / np.linalg.norm(near, axis=1, keepdims=True),
        "parallel": angles * axis,
        "small": any_axis * np.radians(rng.uniform(0, 1.5, _COUNT))[:, None],
        "translation": np.zeros((_COUNT, 3)),
        "identical": np.zeros((_COUNT, 3)),
        "half turns": (np.pi * np.vstack([np.zeros(3), np.eye(3)]))[np.arange(_COUNT) % 4],
        "rotation": any_axis * np.abs(angles),
    }[kind]
    still = kind in ("identical", "rotation")
    return motion_scene(rng, turns, np.zeros_like(moves) if still else moves)


def _solved(truth: Truth, samples: list[HandEyeSample], setup: Setup = Setup.EYE_TO_HAND) -> Answer:
    """Return the error in mm; a weak answer is allowed four times its sigma."""
    result = calibrate_hand_eye(samples, CAMERA, setup)
    if result.pose is None or result.covariance is None:
        return "; ".join(result.assessment.reasons)
    weak = bool(result.assessment.doubts)
    allowed = max(1.0, 4e3 * float(np.sqrt(np.trace(result.covariance[3:, 3:])))) if weak else 1.0
    return truth.error(result.pose)[0], allowed


def _moved(kind: str) -> Callable[[Random], Answer]:
    return lambda rng: _solved(*motion(rng, kind))


def _wrong_setup(rng: Random) -> Answer:
    truth, samples = general_scene(rng, _COUNT, Setup.EYE_IN_HAND)
    return _solved(truth, samples, Setup.EYE_TO_HAND)


def _other_poses(change: Callable[[list[Pose], Random], list[Pose]], rng: Random) -> Answer:
    """Replace the robot's poses. change: returns the poses that are given instead of the true ones."""
    truth, samples = general_scene(rng, _COUNT)
    poses = change([sample.base_T_tcp for sample in samples], rng)
    return _solved(truth, [replace(s, base_T_tcp=pose) for s, pose in zip(samples, poses, strict=True)])


def _each_pose(change: Callable[[Pose, Random], Pose]) -> Callable[[Random], Answer]:
    return partial(_other_poses, lambda poses, rng: [change(pose, rng) for pose in poses])


def _as_euler(pose: Pose, _: Random) -> Pose:
    return Pose.from_rotation(pose.position_m, Rotation.from_euler("xyz", pose.rotation.as_rotvec()))


def _in_mm(pose: Pose, _: Random) -> Pose:
    return Pose.from_rotation(1e3 * np.asarray(pose.position_m), pose.rotation)


def _shifted(spread_m: float, pose: Pose, rng: Random) -> Pose:
    return Pose.from_rotation(rng.normal(pose.position_m, spread_m), pose.rotation)


def _mispaired(poses: list[Pose], _: Random) -> list[Pose]:
    return [*poses[1:], poses[0]]


def _while_moving(poses: list[Pose], rng: Random) -> list[Pose]:
    return [_shifted(0.02, pose, rng) if i in (4, 9) else pose for i, pose in enumerate(poses)]


def _pivot(kind: str, rng: Random) -> Answer:
    """Return the error of the tool tip in m."""
    turns = {
        "narrow": Rotation.from_rotvec(rng.normal(0, 0.02, (12, 3))),
        "one axis": Rotation.from_rotvec(np.outer(rng.uniform(-0.8, 0.8, 12), [0, 0, 1])),
    }.get(kind)
    tip, poses = pivot_scene(rng, 3 if kind == "few" else 12, turns)
    result = calibrate_pivot(poses)
    if result.tip_m is None:
        return "; ".join(result.assessment.reasons)
    return float(np.linalg.norm(result.tip_m - tip)), 1e-3


def _offset(robot: TimedSignal, camera: TimedSignal, true_s: float = _OFFSET_S) -> Answer:
    found = time_offset(robot, camera)
    if found.offset_s is None:
        return "; ".join(found.assessment.reasons)
    return abs(found.offset_s - true_s), _ALLOWED_S


def _wiggled(rng: Random, motion: str = "chirp", offset_s: float = _OFFSET_S) -> Answer:
    return _offset(*wiggle_scene(rng, motion, offset_s), offset_s)


def _gap(rng: Random) -> Answer:
    robot, camera = wiggle_scene(rng)
    since_s = (robot.time_ns - robot.time_ns[0]) / 1e9
    return _offset(_some(robot, (since_s < 8.0) | (since_s > 10.0)), camera)


def _half(rng: Random) -> Answer:
    robot, camera = wiggle_scene(rng)
    return _offset(robot, _some(camera, rng.uniform(size=len(camera.time_ns)) < 0.5))


def _negated(rng: Random) -> Answer:
    robot, camera = wiggle_scene(rng)
    return _offset(robot, TimedSignal(camera.time_ns, -camera.values))


def _some(signal: TimedSignal, kept: np.ndarray) -> TimedSignal:
    return TimedSignal(signal.time_ns[kept], signal.values[kept])


_TOO_FEW = ("usable distinct pose", "rotated by")

CASES: dict[str, tuple[Callable[[Random], Answer], tuple[str, ...]]] = {
    "near-parallel axes (3 degrees off)": (_moved("near-parallel"), ("parallel",)),
    "exactly parallel axes": (_moved("parallel"), ("parallel axes",)),
    "rotations below 3 degrees": (_moved("small"), ("rotated by",)),
    "pure translation": (_moved("translation"), ("rotated by",)),
    "all poses identical": (_moved("identical"), ("same robot pose", "turned by")),
    "relative rotations of 180 degrees": (_moved("half turns"), ("near 180",)),
    "rotation only, place fixed": (_moved("rotation"), ()),
    "two flipped targets of ten": (
        lambda rng: _solved(*general_scene(rng, _COUNT, flipped=4)),
        ("contradict",),
    ),
    "pictures mispaired by one": (partial(_other_poses, _mispaired), ("paired with an offset",)),
    "poses given inverted": (_each_pose(lambda pose, _: pose.inverse()), ("inverted",)),
    "eye-in-hand solved as eye-to-hand": (_wrong_setup, ("inverted", "contradict")),
    "rotation vector read as Euler angles": (_each_pose(_as_euler), ("contradict",)),
    "positions in mm given as m": (_each_pose(_in_mm), ("usable sample",)),
    "target loose by a centimetre": (_each_pose(partial(_shifted, 0.01)), ("contradict",)),
    "two samples taken while moving": (partial(_other_poses, _while_moving), ()),
    "cone of 4 degrees": (partial(_pivot, "narrow"), ("rotated by",)),
    "turns about one axis": (partial(_pivot, "one axis"), ("one axis",)),
    "3 poses": (partial(_pivot, "few"), _TOO_FEW),
    "gap of two seconds": (_gap, ()),
    "half the frames dropped": (_half, ()),
    "sign turned": (_negated, ()),
    "static": (partial(_wiggled, motion="static"), ("share",)),
    "constant": (partial(_wiggled, motion="constant"), ("nothing moved",)),
    "offset beyond the search": (
        partial(_wiggled, offset_s=0.8),
        ("share", "end of the search", "search range", "repeats"),
    ),
}
"""By name: a function that draws the data and calibrates; words of a refusal, if it must be refused."""


@pytest.mark.parametrize("draw", [0, *long(1, 2, 3, 4)])
@pytest.mark.parametrize("name", CASES)
def test_bad_data_is_refused_or_gives_a_correct_result(name: str, draw: int) -> None:
    run, reasons = CASES[name]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            answer = run(np.random.default_rng((0, list(CASES).index(name), draw)))
    except RigError as error:
        answer = str(error)
    if isinstance(answer, str):
        assert any(reason in answer for reason in reasons), answer
    else:
        error, allowed = answer
        assert error <= allowed
