"""Cameras on a bench: a board on the tool shown from many poses, and markers looked at at rest."""

from collections.abc import Callable
from pathlib import Path

import cv2

from calibration.boards import Target
from drivers.errors import OperatorStopError
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye
from protocols.capture_still import capture_still
from protocols.grasps import find_grasp_file
from rig.assembly import build_bench, build_real_bench
from rig.calibrate.bench_hand_eye import candidate_poses, connected
from rig.calibrate.camera import camera_from_folder
from rig.calibrate.outcome import Outcome
from rig.calibrate.sensors import markers_from_folder
from rig.config import load_bench
from rig.operators import ConsoleOperator

_REACH_M = (0.17, 0.10, 0.12)
_STILL_FRAMES = 60


def collect_camera(
    bench_name: str, seed: int, target: Target, count: int, folder: Path, agree: Callable[[str], bool],
    say: Callable[[str], None],
) -> Outcome:  # fmt: skip
    """Show the board, firm on the tool, to the camera from `count` poses, and fit the camera.

    Raises `OperatorStopError` unless the operator agrees to the motion, `DeviceError`, `InputError`.
    """
    config = load_bench(bench_name)
    raw = _emptied(folder / "camera-samples")
    left = [
        (f"{i:03d}", pose) for i, pose in enumerate(candidate_poses(config, seed, _REACH_M)[:count], start=1)
    ]
    if not config.simulated and not agree(
        f"The arm will visit {count} poses around {config.camera.look_at_m} m at up to {SPEED_M_S} m/s, "
        f"tilted by up to 35 degrees, with the board {target.spec} on the tool. Agree?"
    ):
        raise OperatorStopError("stopped: the operator did not agree; nothing was moved")

    def keep(capture: HandEyeCapture) -> None:
        cv2.imwrite(str(raw / f"{capture.id}.png"), cv2.cvtColor(capture.frame.image, cv2.COLOR_RGB2BGR))
        say(f"  {capture.id}: kept")

    def skipped(name: str, reason: str) -> None:
        say(f"  {name}: {reason}")

    with connected(config, seed, target) as bench:
        capture_hand_eye(bench, lambda: left.pop(0) if left else None, keep, skipped)
    outcome = camera_from_folder(raw, "*.png", target, config.camera.serial, keep_all=False)
    return outcome.marked(config.simulated)


def collect_markers(
    bench_name: str, seed: int, object_name: str, folder: Path, agree: Callable[[str], bool]
) -> Outcome:
    """Look at an object's markers while it rests in its place: sixty pictures. Nothing moves."""
    config = load_bench(bench_name)
    grasps = find_grasp_file(object_name)
    raw = _emptied(folder / "markers-samples")
    if config.simulated:
        bench, operator = build_bench(config, seed)
    else:
        bench, operator = build_real_bench(config), ConsoleOperator(agree)
    with bench.connected():
        operator.place(grasps.id, grasps.name)
        for number, frame in enumerate(capture_still(bench, bench.camera, _STILL_FRAMES)):
            cv2.imwrite(str(raw / f"{number:03d}.png"), cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    camera = config.camera
    outcome = markers_from_folder(
        raw, "*.png", camera.marker_ids, camera.marker_dictionary, camera.intrinsics(), camera.serial
    )
    return outcome.marked(config.simulated)


def _emptied(folder: Path) -> Path:
    """The folder, without pictures of an earlier run: they may be of another pose or target."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    return folder
