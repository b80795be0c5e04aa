"""Hand-eye and tool-tip sets that determine nothing, contradict themselves, or are given wrongly."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.hand_eye.samples import HandEyeSample, Setup
from calibration.hand_eye.solve import calibrate_hand_eye
from calibration.poses import pose_from_matrix, pose_from_quaternion, pose_from_rotation_vector
from calibration.tool_tip import calibrate_pivot
from drivers.types import Pose
from rig.benchmark.calibration.degenerate import Case, CaseAnswer, answered, refused
from rig.benchmark.calibration.hand_eye_scenes import CAMERA, Truth, general_scene, motion_scene
from rig.benchmark.calibration.motion_scenes import pivot_scene

Rng = np.random.Generator
_COUNT = 20


def cases() -> list[Case]:
    """All cases of hand-eye motion, hand-eye data, rotations and pivots."""
    return [*_motions(), *_data(), *_rotations(), *_pivots()]


def _motions() -> list[Case]:
    group = "hand-eye motion"
    rows: list[tuple[str, Callable[[Rng], CaseAnswer], tuple[str, ...]]] = [
        ("near-parallel axes (3 degrees off)", partial(_moved, kind="near-parallel"), ("parallel",)),
        ("exactly parallel axes", partial(_moved, kind="parallel"), ("parallel axes",)),
        ("rotations below 3 degrees", partial(_moved, kind="small"), ("turned by",)),
        ("pure translation", partial(_moved, kind="translation"), ("turned by",)),
        ("all poses identical", partial(_moved, kind="identical"), ("same robot pose", "turned by")),
        ("relative rotations of 180 degrees", partial(_moved, kind="half turns"), ("near 180",)),
        ("half the poses duplicated", _duplicated, ()),
        ("rotation only, place fixed", partial(_moved, kind="rotation"), ()),
    ]
    return [Case(group, name, run, reasons, draws=10) for name, run, reasons in rows]


def _data() -> list[Case]:
    group = "hand-eye data"
    few = [
        Case(group, f"{n} poses", partial(_first, count=n), ("usable sample",), draws=3)
        for n in (0, 1, 2, 3, 4)
    ]
    return [
        Case(group, "NaN in one pose", partial(_spoiled, value=float("nan")), (), draws=3),
        Case(group, "inf in one pose", partial(_spoiled, value=float("inf")), (), draws=3),
        Case(group, "NaN in one corner", _nan_corner, (), draws=3),
        *few,
        Case(group, "one flipped target of ten", partial(_flipped, count=2), (), draws=10),
        Case(group, "two flipped targets of ten", partial(_flipped, count=4), ("contradict",), draws=10),
        Case(group, "pictures mispaired by one", _mispaired, ("mispaired",), draws=5),
        Case(group, "poses given inverted", _inverted, ("inverted",), draws=5),
        Case(group, "eye-in-hand solved as eye-to-hand", _wrong_setup, ("inverted", "contradict"), draws=5),
        Case(group, "rotation vector read as Euler angles", _euler, ("contradict",), draws=5),
        Case(group, "positions in mm given as m", _millimetres, ("usable sample",), draws=3),
        Case(group, "target loose by a centimetre", _loose, ("contradict",), draws=5),
        Case(group, "two samples taken while moving", _while_moving, (), draws=5),
    ]


def _rotations() -> list[Case]:
    group = "rotations"
    turn = Rotation.from_rotvec([0.4, -0.3, 0.2])

    def matrix(spoil: np.ndarray) -> Callable[[Rng], CaseAnswer]:
        whole = np.eye(4)
        whole[:3, :3] = turn.as_matrix() @ spoil
        return lambda _: _turned(pose_from_matrix(whole, "pose"), turn)

    def vector(rotvec: np.ndarray) -> Callable[[Rng], CaseAnswer]:
        return lambda _: _turned(
            pose_from_rotation_vector((0, 0, 0), rotvec, "pose"), Rotation.from_rotvec(rotvec)
        )

    def quaternion(values: np.ndarray) -> Callable[[Rng], CaseAnswer]:
        return lambda _: _turned(pose_from_quaternion((0, 0, 0), values, "pose"), turn)

    axis = turn.as_rotvec() / turn.magnitude()
    return [
        Case(group, "scaled by 1.01", matrix(1.01 * np.eye(3)), ("not orthonormal",)),
        Case(group, "reflected (determinant -1)", matrix(np.diag([1.0, 1.0, -1.0])), ("reflection",)),
        Case(
            group,
            "exact identity",
            lambda _: _turned(pose_from_matrix(np.eye(4), "pose"), Rotation.identity()),
        ),
        Case(group, "exactly 180 degrees", vector(np.pi * axis)),
        Case(group, "180 degrees less 1e-9", vector((np.pi - 1e-9) * axis)),
        Case(group, "rotation vector beyond pi", vector((turn.magnitude() + np.pi) * axis)),
        Case(group, "rotation vector in degrees", vector(np.array([90.0, 0, 0])), ("degrees",)),
        Case(group, "quaternion of the other sign", quaternion(-turn.as_quat())),
        Case(group, "quaternion not normalised", quaternion(1.5 * turn.as_quat()), ("length",)),
        Case(group, "quaternion of zeros", quaternion(np.zeros(4)), ("length",)),
    ]


def _pivots() -> list[Case]:
    group = "tool tip"
    return [
        Case(group, "cone of 4 degrees", partial(_pivot, kind="narrow"), ("turned by",), draws=5),
        Case(group, "turns about one axis", partial(_pivot, kind="one axis"), ("one axis",), draws=5),
        Case(
            group,
            "identical poses",
            partial(_pivot, kind="same"),
            ("usable distinct poses", "turned by"),
            draws=5,
        ),
        Case(group, "3 poses", partial(_pivot, kind="few"), ("usable distinct poses", "turned by"), draws=5),
        Case(group, "tip slipped out once", partial(_pivot, kind="slip"), (), draws=5),
    ]


def solved(truth: Truth, samples: list[HandEyeSample], setup: Setup = Setup.EYE_TO_HAND) -> CaseAnswer:
    """Solve a set; an answer called weak may be as far off as its own region says."""
    result = calibrate_hand_eye(samples, CAMERA, setup)
    if result.pose is None or result.spread is None:
        return refused(*result.assessment.reasons)
    distance_mm, _ = truth.error(result.pose)
    weak = bool(result.assessment.doubts)
    allowed = max(1.0, 4e3 * float(np.linalg.norm(result.spread.sigma_m))) if weak else 1.0
    return answered(distance_mm, allowed)


def motion(rng: Rng, kind: str) -> tuple[Truth, list[HandEyeSample]]:
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


def _moved(rng: Rng, kind: str) -> CaseAnswer:
    return solved(*motion(rng, kind))


def _duplicated(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    half = samples[: _COUNT // 2]
    return solved(truth, [*half, *(replace(s, id=s.id + " again") for s in half)])


def _first(rng: Rng, count: int) -> CaseAnswer:
    truth, samples = general_scene(rng, 6)
    return solved(truth, samples[:count])


def _spoiled(rng: Rng, value: float) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    samples[3] = replace(samples[3], base_T_tcp=Pose((value, 0.0, 0.3)))
    return solved(truth, samples)


def _nan_corner(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    pixels = samples[3].view.image_px.copy()
    pixels[1, 0] = np.nan
    samples[3] = replace(samples[3], view=replace(samples[3].view, image_px=pixels))
    return solved(truth, samples)


def _flipped(rng: Rng, count: int) -> CaseAnswer:
    return solved(*general_scene(rng, _COUNT, flipped=count))


def _with_poses(samples: list[HandEyeSample], poses: list[Pose]) -> list[HandEyeSample]:
    return [replace(s, base_T_tcp=p) for s, p in zip(samples, poses, strict=True)]


def _mispaired(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    return solved(truth, _with_poses(samples, [samples[(i + 1) % _COUNT].base_T_tcp for i in range(_COUNT)]))


def _inverted(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    return solved(truth, _with_poses(samples, [s.base_T_tcp.inverse() for s in samples]))


def _wrong_setup(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT, Setup.EYE_IN_HAND)
    return solved(truth, samples, Setup.EYE_TO_HAND)


def _euler(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    wrong = [
        Pose.from_rotation(
            s.base_T_tcp.position_m, Rotation.from_euler("xyz", s.base_T_tcp.rotation.as_rotvec())
        )
        for s in samples
    ]
    return solved(truth, _with_poses(samples, wrong))


def _millimetres(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    poses = [s.base_T_tcp for s in samples]
    wrong = [Pose.from_rotation(1e3 * np.asarray(p.position_m), p.rotation) for p in poses]
    return solved(truth, _with_poses(samples, wrong))


def _shifted(pose: Pose, spread_m: float, rng: Rng) -> Pose:
    return Pose.from_rotation(rng.normal(pose.position_m, spread_m), pose.rotation)


def _loose(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    return solved(truth, _with_poses(samples, [_shifted(s.base_T_tcp, 0.01, rng) for s in samples]))


def _while_moving(rng: Rng) -> CaseAnswer:
    truth, samples = general_scene(rng, _COUNT)
    poses = [
        _shifted(s.base_T_tcp, 0.02, rng) if i in (4, 9) else s.base_T_tcp for i, s in enumerate(samples)
    ]
    return solved(truth, _with_poses(samples, poses))


def _turned(pose: Pose, truth: Rotation) -> CaseAnswer:
    return answered(float((pose.rotation.inv() * truth).magnitude()), 1e-7)


def _pivot(rng: Rng, kind: str) -> CaseAnswer:
    turns = {
        "narrow": Rotation.from_rotvec(rng.normal(0, 0.02, (12, 3))),
        "one axis": Rotation.from_rotvec(np.outer(rng.uniform(-0.8, 0.8, 12), [0, 0, 1])),
        "same": Rotation.from_rotvec(np.zeros((12, 3))),
    }.get(kind)
    tip, poses = pivot_scene(rng, 3 if kind == "few" else 12, turns)
    if kind == "slip":
        poses[3] = ("03", _shifted(poses[3][1], 0.01, rng))
    result = calibrate_pivot(poses)
    if result.tip_m is None:
        return refused(*result.assessment.reasons)
    return answered(float(np.linalg.norm(result.tip_m - tip)), 1e-3)
