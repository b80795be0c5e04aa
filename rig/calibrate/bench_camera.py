"""The camera on a bench: a board shown to it by the arm or by hand in many poses, and markers at rest."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.intrinsics import most_telling
from calibration.targets.boards import Target
from calibration.targets.sheets import target_picture
from drivers.errors import InputError
from drivers.types import Pose
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye, capture_still
from protocols.grasps import find_grasp_file
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.twins import refuse_undrawn
from rig.calibrate.bench import Station, write_picture
from rig.calibrate.bench_hand_eye import visits
from rig.calibrate.camera import camera_from_folder, markers_from_folder
from rig.calibrate.result import CalibrationResult
from rig.config import BenchConfig
from rig.config.fields import ArmLimitsConfig

FEWEST_VIEWS = 3
_CANDIDATES = 400
_NEAREST_M, _TILTS_DEG, _INSIDE_M = 0.25, (10.0, 40.0), 0.01
_HELD_M = (0.0, 0.0, -0.03)
"""Assumed position of a board's middle on the tool."""
_STILL_FRAMES = 60


def collect_camera(station: Station, target: Target, count: int) -> CalibrationResult:
    """Show the board, firm on the tool, to the camera from `count` poses, and fit the camera.

    Where no arm can be moved, a person holds the board in `count` places. Raises `OperatorStopError` unless
    the operator agrees to the motion or holds the board, `DeviceError`, `InputError`.
    """
    config = station.config
    raw = station.raw("camera")
    poses = board_poses(config, target, station.seed, count)
    if not config.moves:
        poses = [poses[i % len(poses)] if poses else Pose((0.0, 0.0, 0.0)) for i in range(count)]
    if len(poses) < FEWEST_VIEWS:
        raise InputError(
            f"the workspace of [arm.limits] holds {len(poses)} places where the whole of {target.spec} "
            "is in the picture: see position_m and look_at_m of [camera], or take a smaller board"
        )
    left = [(f"{i:03d}", pose) for i, pose in enumerate(poses, start=1)]
    kept: list[str] = []

    def keep(capture: HandEyeCapture) -> None:
        write_picture(raw / f"{capture.id}.png", capture.frame.image)
        if station.show is not None:
            station.show(capture.frame)
        kept.append(capture.id)
        station.note(f"{capture.id}: kept", len(kept), len(poses))

    show = _show_on_tool if config.moves else _show_by_hand
    show(station, target, left, keep)
    result = camera_from_folder(raw, "*.png", target, config.camera.serial, keep_all=False)
    return result.marked(config.gives_simulated(config.camera.serial))


def _show_by_hand(
    station: Station, target: Target, left: list[tuple[str, Pose]], keep: Callable[[HandEyeCapture], None]
) -> None:
    """Have a person hold the board before the camera, once for each pose.

    They choose where; the poses are for a simulated person.
    """
    with station.connected(
        f"Nothing moves. You hold the board {target.spec} before the camera, {len(left)} times."
    ) as (bench, operator):
        for name, pose in left:
            operator.hold(
                f"{name} of {len(left)}: hold the board {target.spec} still, all of it in the picture, each "
                "time elsewhere in the picture and tilted another way by 10 to 40 degrees. Is it still?",
                f"{target.spec}@tool",
                pose,
                None,
            )
            keep(HandEyeCapture(name, pose, capture_still(bench, bench.camera, 1)[0]))


def _show_on_tool(
    station: Station, target: Target, left: list[tuple[str, Pose]], keep: Callable[[HandEyeCapture], None]
) -> None:
    """Have the arm show the board, firm on the tool, from each pose; `left` is empty afterwards."""
    count = len(left)
    with station.connected(
        f"The arm will visit {count} poses before the camera at up to {SPEED_M_S} m/s, tilted by up to "
        f"{_TILTS_DEG[1]:g} degrees, with the board {target.spec} on the tool.",
        motions=visits(left),
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        operator.place(f"{target.spec}@tool", f"board {target.spec}, firm on the tool, facing the camera")
        capture_hand_eye(bench, lambda: left.pop(0) if left else None, keep, station.left_out)


def board_poses(config: BenchConfig, target: Target, seed: int, count: int) -> list[Pose]:
    """Return the tool poses that constrain the camera best, at several distances and all over the image.

    The board is assumed on the tool as `rig calibrate camera` asks for, facing the camera.
    """
    model, base_T_camera = config.camera_model(), config.base_T_camera()  # noqa: N806 - frame names
    candidates = _candidates(config, np.random.default_rng((seed, 33)))
    placed = [base_T_camera.inverse() @ pose @ _held(target, base_T_camera) for pose in candidates]
    return [candidates[i] for i in most_telling(model, _outline_m(target), placed, count)]


def _candidates(config: BenchConfig, rng: np.random.Generator) -> list[Pose]:
    """Draw poses all over the picture, from near to where the camera looks, inside the workspace."""
    limits = config.arm.limits if config.has("arm") else ArmLimitsConfig()
    low, high = np.array(limits.workspace_min_m), np.array(limits.workspace_max_m)
    base_T_camera = config.base_T_camera()  # noqa: N806
    half = np.divide(config.camera.size_px, 2.0 * config.camera.focal_px)
    farthest_m = config.object_distance_m()
    poses = []
    for _ in range(_CANDIDATES):
        away_m = rng.uniform(min(_NEAREST_M, farthest_m), farthest_m)
        place = base_T_camera.rotation.apply(away_m * np.append(half * rng.uniform(-1, 1, 2), 1.0))
        axis = rng.normal(0, 1, 3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(*_TILTS_DEG)))
        turned = turn * TOOL_DOWN
        tool = place + base_T_camera.position_m - turned.apply(_HELD_M)
        if (tool > low + _INSIDE_M).all() and (tool < high - _INSIDE_M).all():
            poses.append(Pose.from_rotation(tool, turned))
    return poses


def _held(target: Target, base_T_camera: Pose) -> Pose:  # noqa: N803
    """Return `tcp_T_board` of a board that faces the camera while the tool points down."""
    turn = TOOL_DOWN.inv() * base_T_camera.rotation
    return Pose.from_rotation(np.subtract(_HELD_M, turn.apply(_outline_m(target).mean(axis=0))), turn)


def _outline_m(target: Target) -> NDArray[np.float64]:
    """Return points all over a target's print, (30, 3) m in its axes."""
    sheet = target_picture(target.spec)
    height, width = np.array(sheet.grey.shape[:2]) / sheet.px_per_m
    x, y = np.meshgrid(np.linspace(0, width, 6), np.linspace(0, height, 5))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(30)])
    return points + np.append(np.asarray(sheet.origin_m, float)[:2], 0.0)


def collect_markers(station: Station, object_name: str) -> CalibrationResult:
    """Take sixty pictures of the markers of an object at rest. Nothing moves."""
    config = station.config
    grasps = find_grasp_file(object_name, config.objects)
    refuse_undrawn(config, grasps)
    raw = station.raw("markers")
    with station.connected("Nothing moves; the camera takes pictures of an object.") as (bench, operator):
        operator.place(grasps.id, grasps.name)
        for number, frame in enumerate(capture_still(bench, bench.camera, _STILL_FRAMES, station.show)):
            write_picture(raw / f"{number:03d}.png", frame.image)
        station.note(f"{grasps.name}: {_STILL_FRAMES} pictures", 1, 1)
    camera = config.camera
    result = markers_from_folder(
        raw, "*.png", camera.marker_ids, camera.marker_dictionary, station.camera(), camera.serial
    )
    return result.marked(config.gives_simulated(camera.serial))
