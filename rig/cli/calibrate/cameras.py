"""`rig calibrate camera, hand-eye, markers`: calibrate a camera, its pose, and its marker angle."""

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
from rig.cli.options import ObjectsOption
from rig.declared import option

if TYPE_CHECKING:
    from calibration.hand_eye.samples import Setup
    from calibration.targets.boards import Target
    from rig.calibrate.result import CalibrationResult


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """The calibration board, and its views."""

    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100"
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    keep_all: bool = option(False, "Do not reject outliers among the views.")
    poses: PosesOption = 20


def camera(context: typer.Context, common: StationOptions, options: CameraOptions) -> None:
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
    """The target, the camera, and where the camera is mounted."""

    target: TargetOption = "marker:60:DICT_4X4_50:0"
    camera_file: CameraFile = None
    setup: str = option("eye-to-hand", "eye-to-hand (fixed camera) or eye-in-hand (camera on the tool).")
    serial: CameraSerial = "unknown"
    poses: PosesOption = 20


def hand_eye(context: typer.Context, common: StationOptions, options: HandEyeOptions) -> None:
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

    ids: tuple[int, int] = option((0, 1), "Ids of the two markers.")
    dictionary: str = option("DICT_4X4_50", "ArUco dictionary: OpenCV's name, or a file.")
    camera_file: CameraFile = None
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    object_name: str = option("wrench", "On a bench: object with the markers.", "--object")
    objects: ObjectsOption = None


def markers(context: typer.Context, common: StationOptions, options: MarkersOptions) -> None:
    """Measure the noise of the angle from two markers, on pictures of an object at rest.

    On a bench the camera takes sixty pictures of an object in its place. Nothing moves.

    The folder of --from holds at least twenty pictures, taken one after the other while nothing moves.

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
