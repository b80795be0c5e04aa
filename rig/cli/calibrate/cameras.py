"""`rig calibrate camera, hand-eye, markers`: a camera, where it stands, and how well it tells angles."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from drivers.errors import InputError
from rig.cli.calibrate.options import (
    CameraFile,
    CameraSerial,
    PicturesOption,
    PosesOption,
    StationOptions,
    TargetOption,
    calibrated,
)
from rig.cli.declared import option
from rig.cli.options import ObjectsOption

if TYPE_CHECKING:
    from calibration.hand_eye.samples import Setup
    from calibration.targets.boards import Target
    from rig.calibrate.result import CalibrationResult


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """The board, and its views."""

    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100"
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    keep_all: bool = option(False, "Keep views that contradict the others.")
    poses: PosesOption = 20


def camera(context: typer.Context, common: StationOptions, options: CameraOptions) -> None:
    """Fit a camera to views of a board; the lens model is the one that predicts unseen views best.

    On a bench the arm holds the board and shows it from --poses places and tilts; without an arm you do, and
    confirm each picture.

    The folder of --from holds pictures of one board by one camera, at one focus and zoom: 10 to 20,
    tilted by 30 degrees each way, over the whole picture. --target says which board; lens, outliers
    and verdict are found from the views.

    A chessboard's corners are refined in windows that hold no neighbour; :11 behind the target sets
    OpenCV's fixed 11 px. On OpenCV's own chessboard photos that recipe (--target chessboard:9x6:25:11
    --keep-all) gives the published numbers and misses unseen views by 0.42 px; the default by 0.18.

    Examples:
      rig calibrate camera --bench fake --poses 20

      rig calibrate camera --bench fake --watch

      rig calibrate camera --from photos --target chessboard:9x6:25 --pictures 'left*.jpg'

    """
    from calibration.targets.boards import parse_target
    from rig.calibrate.bench_camera import collect_camera
    from rig.calibrate.camera import camera_from_folder

    wanted = parse_target(options.target)
    calibrated(
        context,
        common,
        ("views", options.poses),
        lambda at: collect_camera(at, wanted, options.poses),
        lambda samples: camera_from_folder(
            samples, options.pattern, wanted, options.serial, options.keep_all
        ),
    )


@dataclass(frozen=True, slots=True)
class HandEyeOptions:
    """The target, the camera, and its place."""

    target: TargetOption = "marker:60:DICT_4X4_50:0"
    camera_file: CameraFile = None
    setup: str = option("eye-to-hand", "eye-to-hand or eye-in-hand.")
    serial: CameraSerial = "unknown"
    poses: PosesOption = 20


def hand_eye(context: typer.Context, common: StationOptions, options: HandEyeOptions) -> None:
    """Find where the camera is: base_T_camera of one that stands, tcp_T_camera of one in the hand.

    On a bench the arm visits --poses poses, each the one that tells most, and waits for stillness.
    eye-to-hand: the target is firm on the tool. eye-in-hand: the target lies on the table's mark, and
    the camera is on the tool, looking past the fingers. The camera is that of calibrations/, if there.

    The folder of --from holds <id>.png (or .jpg ...) and poses.csv, one row for each picture: id,
    x_m, y_m, z_m and qx, qy, qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them): base_T_tcp.
    Pictures and poses are paired by id, never by their order. The answer's quaternion is xyzw.

    With targets.csv instead of pictures, the target's poses in the camera (camera_T_target) in the same
    columns, as another detector gave them, no --camera is needed: the noise of both is found from the pairs.

    Examples:
      rig calibrate hand-eye --from samples --camera camera.yaml --target marker:60:DICT_4X4_50:0

      rig calibrate hand-eye --bench fake --poses 15

      rig calibrate hand-eye --bench fake --setup eye-in-hand

    """
    from calibration.hand_eye.samples import Setup
    from calibration.targets.boards import parse_target
    from rig.calibrate.bench_hand_eye import collect_hand_eye

    if options.setup not in list(Setup):
        raise InputError(f"--setup '{options.setup}': use {' or '.join(Setup)}")
    wanted, setup = parse_target(options.target), Setup(options.setup)
    calibrated(
        context,
        common,
        ("poses", options.poses),
        lambda at: collect_hand_eye(at, wanted, setup, options.poses),
        lambda samples: _hand_eye_from(samples, wanted, setup, options),
    )


def _hand_eye_from(
    samples: Path, wanted: "Target", setup: "Setup", options: HandEyeOptions
) -> "CalibrationResult":
    """Calibrate from pictures of a target, or from its poses if the folder holds them."""
    from calibration.camera.files import read_camera
    from rig.calibrate.hand_eye import TARGETS, hand_eye_from_folder, hand_eye_from_poses

    serial = options.serial
    if (samples / TARGETS).is_file():
        return hand_eye_from_poses(samples, serial, setup)
    if options.camera_file is None:
        raise InputError("hand-eye needs the camera's intrinsics: give --camera FILE (rig calibrate camera)")
    known = read_camera(options.camera_file, None if serial == "unknown" else serial)
    return hand_eye_from_folder(samples, wanted, known, serial, setup)


@dataclass(frozen=True, slots=True)
class MarkersOptions:
    """The markers, and the object that carries them."""

    ids: tuple[int, int] = option((0, 1), "The two marker ids.")
    dictionary: str = option("DICT_4X4_50", "OpenCV's name, or a file.")
    camera_file: CameraFile = None
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    object_name: str = option("wrench", "Object to look at on a bench.", "--object")
    objects: ObjectsOption = None


def markers(context: typer.Context, common: StationOptions, options: MarkersOptions) -> None:
    """Measure how well the two-marker angle is known, from pictures of the object at rest.

    On a bench the camera looks at an object in its place, sixty times; nothing moves.

    The folder of --from holds twenty pictures or more, taken one after the other, nothing moving.

    Examples:
      rig calibrate markers --bench fake

      rig calibrate markers --from still --camera calibrations/camera-C1.yaml

    """
    from rig.calibrate.bench_camera import collect_markers

    calibrated(
        context,
        common,
        ("objects", 1),
        lambda at: collect_markers(at, options.object_name),
        lambda samples: _markers_from(samples, options),
        objects=options.objects,
    )


def _markers_from(samples: Path, options: MarkersOptions) -> "CalibrationResult":
    from calibration.camera.files import read_camera
    from rig.calibrate.camera import markers_from_folder

    lens = None if options.camera_file is None else read_camera(options.camera_file)
    return markers_from_folder(
        samples, options.pattern, options.ids, options.dictionary, lens, options.serial
    )
