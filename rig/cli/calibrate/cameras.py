"""`rig calibrate camera, hand-eye, markers`: a camera, where it stands, and how well it tells angles."""

from typing import Annotated

import typer

from rig.cli.calibrate.options import (
    CameraFile,
    CameraSerial,
    PicturesOption,
    PosesOption,
    StationOptions,
    TargetOption,
    file_and_say,
    recorded,
    station,
)
from rig.cli.common import ObjectsOption


def camera(
    context: typer.Context,
    common: StationOptions,
    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100",
    pattern: PicturesOption = "*",
    serial: CameraSerial = "unknown",
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Keep views that contradict the others.")
    ] = False,
    poses: PosesOption = 20,
) -> None:
    """Fit a camera to views of a board; the lens model is the one that predicts unseen views best.

    On a bench the arm holds the board and shows it from --poses places and tilts.

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

    wanted = parse_target(target)
    if common.source is None:
        with station(context, common, "views", poses) as at:
            file_and_say(collect_camera(at, wanted, poses), common)
    else:
        result = camera_from_folder(recorded(common.source, common), pattern, wanted, serial, keep_all)
        file_and_say(result, common)


def hand_eye(
    context: typer.Context,
    common: StationOptions,
    target: TargetOption = "marker:60:DICT_4X4_50:0",
    camera_file: CameraFile = None,
    setup: Annotated[str, typer.Option("--setup", help="eye-to-hand or eye-in-hand.")] = "eye-to-hand",
    serial: CameraSerial = "unknown",
    poses: PosesOption = 20,
) -> None:
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
    from calibration.camera.files import read_camera
    from calibration.hand_eye.samples import Setup
    from calibration.targets.boards import parse_target
    from drivers.errors import InputError
    from rig.calibrate.bench_hand_eye import collect_hand_eye
    from rig.calibrate.hand_eye import TARGETS, hand_eye_from_folder, hand_eye_from_poses

    if setup not in list(Setup):
        raise InputError(f"--setup '{setup}': use {' or '.join(Setup)}")
    wanted = parse_target(target)
    if common.source is None:
        with station(context, common, "poses", poses) as at:
            file_and_say(collect_hand_eye(at, wanted, Setup(setup), poses), common)
        return
    if (recorded(common.source, common) / TARGETS).is_file():
        result = hand_eye_from_poses(common.source, serial, Setup(setup))
    else:
        if camera_file is None:
            raise InputError(
                "hand-eye needs the camera's intrinsics: give --camera FILE (rig calibrate camera)"
            )
        known = read_camera(camera_file, None if serial == "unknown" else serial)
        result = hand_eye_from_folder(common.source, wanted, known, serial, Setup(setup))
    file_and_say(result, common)


def markers(
    context: typer.Context,
    common: StationOptions,
    ids: Annotated[tuple[int, int], typer.Option("--ids", help="The two marker ids.")] = (0, 1),
    dictionary: Annotated[
        str, typer.Option("--dictionary", help="OpenCV's name, or a file.")
    ] = "DICT_4X4_50",
    camera_file: CameraFile = None,
    pattern: PicturesOption = "*",
    serial: CameraSerial = "unknown",
    object_name: Annotated[str, typer.Option("--object", help="Object to look at on a bench.")] = "wrench",
    objects: ObjectsOption = None,
) -> None:
    """Measure how well the two-marker angle is known, from pictures of the object at rest.

    On a bench the camera looks at an object in its place, sixty times; nothing moves.

    The folder of --from holds twenty pictures or more, taken one after the other, nothing moving.

    Examples:
      rig calibrate markers --bench fake

      rig calibrate markers --from still --camera calibrations/camera-C1.yaml

    """
    from calibration.camera.files import read_camera
    from rig.calibrate.bench_camera import collect_markers
    from rig.calibrate.camera import markers_from_folder

    if common.source is None:
        with station(context, common, "objects", 1, objects=objects) as at:
            file_and_say(collect_markers(at, object_name), common)
    else:
        lens = None if camera_file is None else read_camera(camera_file)
        result = markers_from_folder(recorded(common.source, common), pattern, ids, dictionary, lens, serial)
        file_and_say(result, common)
