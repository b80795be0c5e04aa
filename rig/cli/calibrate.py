"""`rig calibrate`: write calibration files and pages, from recorded samples or on the bench."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.errors import CalibrationError, InputError
from rig.cli.common import mark, print_result, say
from rig.cli.helping import Commands
from rig.cli.options import (
    BenchOption,
    DryRunOption,
    JsonOption,
    ObjectsOption,
    SeedOption,
    WatchOptions,
    YesOption,
)
from rig.cli.resuming import dry_run, watched
from rig.declared import argument, file_place, folder_place, is_given, option
from rig.terminal.questions import ask, ask_line
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.calibrate.result import CalibrationResult

TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        help="Target (squares, sizes in mm, ArUco dictionary): charuco:8x6:25:18:DICT_5X5_100 (append "
        ":legacy for the pattern of OpenCV before 4.6), chessboard:9x6:25[:px] or marker:60:DICT_4X4_50:0.",
    ),
]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="Camera file of the rig, ROS or OpenCV.")]
CameraSerial = Annotated[str, typer.Option("--serial", help="Serial of the camera.")]
PicturesOption = Annotated[
    str, typer.Option("--pictures", help="With --from: pattern of the picture files, as 'left*.jpg'.")
]
PosesOption = Annotated[int, typer.Option("--poses", min=5, max=60, help="On a bench: number of poses.")]
_BLOCKS_MM = [8.0, 15.0, 25.0, 35.0, 50.0, 65.0, 80.0, 95.0]
"""Default widths of the blocks on a bench."""

calibrate = Commands(
    no_args_is_help=True,
    help="Calibrate cameras, sensors, gripper, tool and clocks; write files with uncertainty and a page.\n\n"
    "Samples are collected on --bench, with a question before each motion, or read with --from FOLDER (the "
    "help of each command describes the folder). Results go to --out, by default calibrations/ beside the "
    "bench file (for a built-in bench, in the current folder), where rig trial and rig record find them.",
)


@dataclass(frozen=True)
class StationOptions(WatchOptions):
    """The source of a calibration's samples, and the folder of its file."""

    source: Path | None = option(None, "Folder of recorded samples. Default: collect on --bench.", "--from")
    bench: BenchOption = "fake"
    seed: SeedOption = 0
    dry: DryRunOption = False
    yes: YesOption = False
    out: Path | None = option(None, "Folder for the calibration file and its page.", callback=folder_place)
    json: JsonOption = False

    @property
    def files(self) -> Path:
        """Folder of the calibration files: --out, by default the folder that trials on the bench read."""
        from rig.config.calibrations import calibrations_folder

        return self.out or calibrations_folder(self.bench)


def calibrated(
    context: typer.Context,
    options: StationOptions,
    work: tuple[str, int],
    on_bench: Sequence[object],
    from_folder: Callable[[], Sequence[object]],
    agreed: bool = False,
    objects: Path | None = None,
    needs: str = "",
) -> None:
    """Calibrate from the folder of --from, or on the bench without it; store and print the results.

    work: name and number of the items for the watch page. on_bench, from_folder: arguments of the kind's
    `collect` and `solve`, after the station and the folder. agreed: whether every question is agreed to, as
    with --yes. objects: folder of own objects. needs: name in `rig.config.parts.NEEDS`, by default that of
    the command. With --dry-run the plan is shown, as by `dry_run`, and the command ends. Raises `InputError`.
    """
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate.bench import Station
    from rig.calibrate.kinds import KINDS
    from rig.config import load_bench
    from rig.config.objects import with_objects
    from rig.config.parts import require_parts
    from rig.live.observer import PictureSender

    kind, source = KINDS[str(context.info_name)], options.source
    if source is not None:
        for name, given in (("watch", options.watch), ("watch-at", options.watch_at)):
            if given:
                raise InputError(
                    f"--{name} is for a calibration on a bench: leave it out with --from {source}"
                )
        begin_phase(f"calibrating from {source}")
        _file(kind.solve(source, *from_folder()), options)
        return
    config = with_objects(load_bench(options.bench), options.bench, objects)
    require_parts(config, needs or f"rig calibrate {context.info_name}")
    simulated = mark(config.simulated and not config.mixed)
    title = f"{simulated}calibrate {context.info_name} on bench '{config.name}'"
    say(title)
    with ExitStack() as stack:
        watch = WatchOptions() if options.dry else options
        listeners = stack.enter_context(watched(context, watch, title, *work))
        show = stack.enter_context(closing(PictureSender(listeners))) if listeners else None
        person = ConsoleOperator(ask, agreed or options.yes, ask_line)
        before = partial(dry_run, config, json=options.json) if options.dry else lambda plan: None
        at = Station(config, options.seed, options.files, person, say, before, show)
        _file(kind.collect(at, *on_bench), options)


def _file(results: "CalibrationResult | list[CalibrationResult]", options: StationOptions) -> None:
    """Store results; print their verdicts, figures, rejected samples and paths.

    Raises `CalibrationError` at the end if any is refused.
    """
    if not isinstance(results, list):
        figures = _filed(results, options.files)
        print_result(options.json, figures, figures["file"], figures["page"])
        return
    filed: list[dict[str, Any]] = []
    refused: list[str] = []
    for result in results:
        try:
            filed.append(_filed(result, options.files))
        except CalibrationError as error:
            refused.append(str(error))
            say(str(error))
    paths = [each[name] for each in filed for name in ("file", "page")]
    print_result(options.json, {"calibrations": filed, "refused": refused}, *paths)
    if refused:
        raise CalibrationError(f"{len(refused)} of {len(results)} calibrations were refused; see their pages")


def _filed(result: "CalibrationResult", folder: Path) -> dict[str, Any]:
    """Store a result, and return its figures; print the rejected samples before, and its verdict after."""
    from calibration.verdict import counted_reasons
    from rig.calibrate.result import file_result

    for line in counted_reasons(result.rejected):
        say(f"left out {line}")
    filed = file_result(result, folder)
    say(f"{mark(result.simulated)}{result.kind} calibration, {result.about}: {result.assessment}")
    for name, text in result.numbers.items():
        say(f"  {name}: {text}")
    return filed


@dataclass(frozen=True)
class CameraOptions(StationOptions):
    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100"
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    keep_all: bool = option(False, "Do not reject outliers among the views.")
    poses: PosesOption = 20


def camera(context: typer.Context, options: CameraOptions) -> None:
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

    target = parse_target(options.target)
    calibrated(
        context,
        options,
        ("views", options.poses),
        (target, options.poses),
        lambda: (options.pattern, target, options.serial, options.keep_all),
    )


@dataclass(frozen=True)
class HandEyeOptions(StationOptions):
    target: TargetOption = "marker:60:DICT_4X4_50:0"
    camera_file: CameraFile = None
    setup: str = option("eye-to-hand", "eye-to-hand (fixed camera) or eye-in-hand (camera on the tool).")
    serial: CameraSerial = "unknown"
    poses: PosesOption = 20


def hand_eye(context: typer.Context, options: HandEyeOptions) -> None:
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
    from calibration.hand_eye.solve import Setup
    from calibration.targets.boards import parse_target

    if options.setup not in list(Setup):
        raise InputError(f"--setup '{options.setup}': use {' or '.join(Setup)}")
    target, setup = parse_target(options.target), Setup(options.setup)
    calibrated(
        context,
        options,
        ("poses", options.poses),
        (target, setup, options.poses),
        lambda: (target, options.camera_file, options.serial, setup),
    )


@dataclass(frozen=True)
class MarkersOptions(StationOptions):
    ids: tuple[int, int] = option((0, 1), "Ids of the two markers.")
    dictionary: str = option("DICT_4X4_50", "ArUco dictionary: OpenCV's name, or a file.")
    camera_file: CameraFile = None
    pattern: PicturesOption = "*"
    serial: CameraSerial = "unknown"
    object_name: str = option("wrench", "On a bench: object with the markers.", "--object")
    objects: ObjectsOption = None


def markers(context: typer.Context, options: MarkersOptions) -> None:
    """Measure the noise of the angle from two markers, on pictures of an object at rest.

    On a bench the camera takes sixty pictures of an object in its place. Nothing moves.

    The folder of --from holds at least twenty pictures, taken one after the other while nothing moves.

    Examples:
      rig calibrate markers --bench fake
      rig calibrate markers --from still --camera calibrations/camera-C1.yaml
    """
    from calibration.camera.files import read_camera

    def from_folder() -> tuple[object, ...]:
        lens = None if options.camera_file is None else read_camera(options.camera_file)
        return options.pattern, options.ids, options.dictionary, lens, options.serial

    calibrated(context, options, ("objects", 1), (options.object_name,), from_folder, objects=options.objects)


@dataclass(frozen=True)
class TactileOptions(StationOptions):
    folder: Path | None = argument(None, "Folder of photographs of pressed balls; as --from.")
    balls_mm: list[float] | None = option(
        None, "On a bench: diameter of a ball to press, in mm; repeat for a second size.", "--ball-mm"
    )
    presses: int = option(16, "Number of presses of each ball.", min=8, max=100)
    mm_per_px: tuple[float, float] | None = option(
        None, "With --from: scale along x and y in mm per px, if known."
    )
    serial: str = option("unknown", "Serial of the sensor.")
    background: Path | None = option(None, "Picture without contact. Default: background.png of the folder.")
    circles: Path | None = option(
        None,
        "CSV of hand-drawn circles: frame, center_x, center_y, radius (px). Default: circles.csv.",
    )
    untouched: Path | None = option(
        None, "Folder of at least 8 frames without contact, for noise and background. Default: the presses'."
    )


def tactile(context: typer.Context, options: TactileOptions) -> None:
    """Calibrate a gel's scale and its map from colour to surface slope, from presses of balls.

    On a bench with --ball-mm the fingers press each ball at many places of both gels. The scale in mm per px
    is found from the steps of the arm. Without --ball-mm nothing moves: a frame of each fingertip without
    contact is stored as its reference, and compared with the previous reference (LEDs, gel, drift).

    The folder of --from holds background.png (without contact), catalog.csv and the pictures that it lists.
    Its columns are image and diameter(mm). Optional columns are x_mm and y_mm (position of the ball, to the
    right and down in the picture, from which the scale is found), and background (a picture without contact
    for this row). The balls are detected in the pictures. Without catalog.csv, --ball-mm is the diameter
    of the ball in all pictures.

    The look of the sensor is stored beside the file, in tactile-SERIAL.npz: its colours by slope and place,
    background, noise and JPEG quality. The key tactile.look of a bench file simulates a gel with it.

    Examples:
      rig calibrate tactile presses --ball-mm 8.8 --background bg.png --serial D20641
      rig calibrate tactile --bench fake
      rig calibrate tactile --bench fake --ball-mm 5 --ball-mm 9.5
      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1
    """
    balls_mm, source = options.balls_mm or [], options.folder or options.source
    if source and len(balls_mm) > 1:
        raise InputError("--ball-mm was given twice: name each picture's ball in catalog.csv instead")
    calibrated(
        context,
        replace(options, source=source),
        ("presses", options.presses * len(balls_mm)) if balls_mm else ("fingertips", 2),
        (balls_mm, options.presses),
        lambda: (
            options.serial,
            options.mm_per_px,
            balls_mm[0] if balls_mm else None,
            options.background,
            options.circles,
            options.untouched,
        ),
        needs="rig calibrate tactile --ball-mm" if balls_mm else "",
        agreed=not balls_mm,  # without balls nothing moves, so no consent is needed
    )


@dataclass(frozen=True)
class GripperOptions(StationOptions):
    blocks_mm: list[float] | None = option(
        None, "On a bench: width in mm of a block to grasp; repeat for more.", "--block-mm"
    )
    serial: str = option("unknown", "Serial of the gripper.")


def gripper(context: typer.Context, options: GripperOptions) -> None:
    """Calibrate the gripper's opening in mm as a monotone function of its counts, and its hysteresis.

    On a bench the fingers close on blocks of known width (8 to 95 mm, or --block-mm) until both gels detect
    contact, then open until the contact is lost.

    The folder of --from holds gripper.csv with the columns counts, opening_mm and direction (closing or
    opening). Openings in another unit than mm are refused: they are compared with the range of the gripper
    of --bench.

    Examples:
      rig calibrate gripper --bench fake
      rig calibrate gripper --from measured --serial R3F-1
    """
    from rig.config import load_bench

    blocks_mm = options.blocks_mm or _BLOCKS_MM
    calibrated(
        context,
        options,
        ("contacts", 2 * len(blocks_mm)),
        (blocks_mm,),
        lambda: (options.serial, load_bench(options.bench).gripper.limits.spec().resolution_m),
    )


@dataclass(frozen=True)
class TcpOptions(StationOptions):
    poses: int = option(12, "On a bench: number of tilts.", min=4, max=60)
    serial: str = option("unknown", "Serial of the tool.")
    accept_change: bool = option(
        False, "Accept a tip more than 50 mm from the bench file's tcp_m (--yes alone does not accept it)."
    )


def tcp(context: typer.Context, options: TcpOptions) -> None:
    """Calibrate the position of a clamped pointed tip in the flange frame, by pivoting it in a small hole.

    On a bench the fingers hold a pointed tip. The arm tilts it above the hole. You then step it into the hole
    by typing the remaining distance (x y z in mm, base axes), and press Enter alone when it sits.

    The tip is not the bench file's tcp_m, the point between the gels, because it sticks out of the fingers.
    The result gives both, and the vector from tcp_m to the tip along the tool's axes. Measure the same vector
    with a calliper, from the middle of the gels to the tip. If the two differ, correct tcp_m by the
    difference. The calibration does not use tcp_m; it is refused if the tip is more than 50 mm from it.

    The folder of --from holds poses.csv with a row per seated pose. The columns are id, x_m, y_m, z_m; qx,
    qy, qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them); and child_frame, which is flange, or tcp for
    poses of the tool centre point of the --bench file. With --bench the tip is compared with its tcp_m.

    Examples:
      rig calibrate tcp --bench fake
      rig calibrate tcp --from pivot
    """
    from rig.config import load_bench

    def from_folder() -> tuple[object, ...]:
        tool = load_bench(options.bench).arm.flange_T_tcp() if is_given(context, "bench") else None
        return options.serial, tool, options.accept_change

    calibrated(
        context, options, ("tilts", options.poses), (options.poses, options.accept_change), from_folder
    )


@dataclass(frozen=True)
class SyncOptions(StationOptions):
    first: str = option("robot", "Stream whose clock is the reference.", "--reference")
    second: str = option("camera", "Stream whose offset from the reference is estimated.", "--stream")
    search: float = option(0.5, "Largest offset to search for, s.", min=0.01, max=10)
    object_name: str = option(
        "gauge:30", "On a bench: object with the markers, or gauge:WIDTH for a block (mm).", "--object"
    )
    objects: ObjectsOption = None


def sync(context: typer.Context, options: SyncOptions) -> None:
    """Estimate the time offset and drift between streams that measured the same motion.

    On a bench the arm moves an object with markers up and down by 1 cm. The offsets of the camera and of both
    fingertips from the arm's clock are estimated. If the bench lacks an arm, a gripper or the second
    fingertip, nothing moves: you press the object onto the gel and turn it to and fro by hand, and the
    offsets of the fingertips from the camera's clock are estimated.

    The folder of --from holds <name>.csv for both streams. The columns are time_ns (or t_s) and value, any
    quantity that changes with the motion. Its unit does not matter and may differ between the streams, since
    only the time offset is estimated. Long, fast and irregular motions give the best results. Instead of
    value the columns may be an orientation, qx, qy, qz, qw. Then the turning speeds are compared, which
    are equal for two sensors on one rigid body.

    Examples:
      rig calibrate sync --bench fake
      rig calibrate sync --from wiggle --reference robot --stream camera
    """
    calibrated(
        context,
        options,
        ("wiggles", 1),
        (options.object_name, options.search),
        lambda: (options.first, options.second, options.search),
        objects=options.objects,
    )


for command in (camera, hand_eye, markers, tactile, gripper, tcp, sync):
    calibrate.command()(command)


@calibrate.command()
def board(
    target: Annotated[
        str, typer.Argument(help="Target, in the form of --target of the other commands.")
    ] = "charuco:8x6:25:18:DICT_5X5_100",
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write, .svg or .pdf.", callback=file_place)
    ] = None,
    json: JsonOption = False,
) -> None:
    """Draw a target to print at a scale of 100 %, with a bar of 100 mm to check with a ruler.

    Measure one side of a square or marker after printing. If it differs, put the measured length into the
    target's name.

    Examples:
      rig calibrate board charuco:8x6:25:18:DICT_5X5_100 --out board.pdf
      rig calibrate board marker:60:DICT_4X4_50:0 --out marker.svg
    """
    from calibration.store import write_bytes
    from calibration.targets.sheets import sheet_svg
    from rig.calibrate.figures import sheet_pdf

    path = out or Path(f"{target.replace(':', '_')}.svg")
    makers = {".svg": lambda: sheet_svg(target).encode(), ".pdf": lambda: sheet_pdf(target)}
    if path.suffix.lower() not in makers:
        raise InputError(f"--out {path}: give a file ending in .svg or .pdf")
    write_bytes(path, makers[path.suffix.lower()]())
    print_result(json, {"target": target, "file": str(path)}, path)


@calibrate.command()
def compare(
    one: Annotated[Path, typer.Argument(help="Calibration file.")],
    other: Annotated[Path, typer.Argument(help="Calibration file of the same kind to compare with.")],
    json: JsonOption = False,
) -> None:
    """Print how far two calibrations differ, in px over the picture or in mm over the workspace.

    Examples:
      rig calibrate compare calibrations/camera-C1.yaml old/camera-C1.yaml
    """
    from rig.calibrate.kinds import compare_files

    figures = compare_files(one, other)
    print_result(json, figures, *(f"{name}: {value}" for name, value in figures.items()))
