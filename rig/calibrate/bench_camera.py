"""The camera on a bench: a board on the tool shown to it from many poses, and markers at rest."""

from calibration.targets.boards import Target
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye
from protocols.capture_still import capture_still
from protocols.grasps import find_grasp_file
from protocols.readiness import agree_to_carry
from rig.calibrate.bench import Station, write_picture
from rig.calibrate.bench_hand_eye import facing_poses, visits
from rig.calibrate.camera import camera_from_folder
from rig.calibrate.markers import markers_from_folder
from rig.calibrate.result import CalibrationResult

_REACH_M = (0.17, 0.10, 0.12)
_STILL_FRAMES = 60


def collect_camera(station: Station, target: Target, count: int) -> CalibrationResult:
    """Show the board, firm on the tool, to the camera from `count` poses, and fit the camera.

    Raises `OperatorStopError` unless the operator agrees to the motion, `DeviceError`, `InputError`.
    """
    config = station.config
    raw = station.raw("camera")
    poses = facing_poses(config, station.seed, _REACH_M)[:count]
    left = [(f"{i:03d}", pose) for i, pose in enumerate(poses, start=1)]

    def keep(capture: HandEyeCapture) -> None:
        write_picture(raw / f"{capture.id}.png", capture.frame.image)
        station.say(f"  {capture.id}: kept")

    with station.connected(
        f"The arm will visit {count} poses around {config.camera.look_at_m} m at up to {SPEED_M_S} m/s, "
        f"tilted by up to 35 degrees, with the board {target.spec} on the tool.",
        motions=visits(left),
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        operator.place(f"{target.spec}@tool", f"board {target.spec}, firm on the tool, facing the camera")
        capture_hand_eye(
            bench,
            lambda: left.pop(0) if left else None,
            keep,
            lambda name, why: station.say(f"  {name}: {why}"),
        )
    result = camera_from_folder(raw, "*.png", target, config.camera.serial, keep_all=False)
    return result.marked(config.simulated)


def collect_markers(station: Station, object_name: str) -> CalibrationResult:
    """Look at an object's markers while it rests in its place: sixty pictures. Nothing moves."""
    config = station.config
    grasps = find_grasp_file(object_name)
    raw = station.raw("markers")
    with station.connected("Nothing moves; the camera looks at an object.") as (bench, operator):
        operator.place(grasps.id, grasps.name)
        for number, frame in enumerate(capture_still(bench, bench.camera, _STILL_FRAMES)):
            write_picture(raw / f"{number:03d}.png", frame.image)
    camera = config.camera
    result = markers_from_folder(
        raw, "*.png", camera.marker_ids, camera.marker_dictionary, station.camera(), camera.serial
    )
    return result.marked(config.simulated)
