"""`rig calibrate`: calibration files and pages from recorded samples, or from the bench."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import BenchOption, JsonOption, SeedOption, YesOption, ask, emit_json, say

if TYPE_CHECKING:
    from rig.calibrate.outcome import Filed, Outcome

calibrate = typer.Typer(
    no_args_is_help=True,
    help="Turn samples into calibration files with their uncertainty, a verdict and a page.\n\n"
    "With --from FOLDER everything is solved from files. Files go to --out, by default calibrations/ "
    "beside the bench file (for the built-in benches: here).",
)

FromOption = Annotated[Path | None, typer.Option("--from", help="Folder of recorded samples.")]
OutFolder = Annotated[Path | None, typer.Option("--out", help="Folder of the calibration file and its page.")]
TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        help="charuco:8x6:25:18:DICT_5X5_100[:legacy], chessboard:9x6:25[:px], marker:60:DICT_4X4_50:0.",
    ),
]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="Camera file: ours, ROS or OpenCV.")]


@calibrate.command()
def camera(
    source: FromOption = None,
    target: TargetOption = "charuco:8x6:25:18:DICT_5X5_100",
    pattern: Annotated[str, typer.Option("--pictures", help="Which pictures of the folder.")] = "*",
    serial: Annotated[str, typer.Option("--serial", help="Of the camera.")] = "unknown",
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Keep views that contradict the others.")
    ] = False,
    poses: Annotated[int, typer.Option("--poses", min=5, max=60, help="Poses to visit on a bench.")] = 20,
    bench: BenchOption = "fake",
    seed: SeedOption = 0,
    yes: YesOption = False,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Fit a camera to views of a board; the lens model is the one that predicts unseen views best.

    Without --from the board is shown by the arm, which holds it. On OpenCV's own chessboard photos
    its published numbers come out with its own recipe: --target chessboard:9x6:25:11 --keep-all.

    Examples:
      rig calibrate camera --bench fake --poses 20

      rig calibrate camera --from photos --target chessboard:9x6:25 --pictures 'left*.jpg'

    """
    from calibration.boards import parse_target
    from rig.calibrate.bench_camera import collect_camera
    from rig.calibrate.camera import camera_from_folder

    wanted = parse_target(target)
    if source is None:
        agree = (lambda _: True) if yes else ask
        outcome = collect_camera(bench, seed, wanted, poses, _out(out, bench), agree, say)
    else:
        outcome = camera_from_folder(source, pattern, wanted, serial, keep_all)
    _file(outcome, out, bench, json)


@calibrate.command("hand-eye")
def hand_eye(
    source: FromOption = None,
    target: TargetOption = "marker:60:DICT_4X4_50:0",
    camera_file: CameraFile = None,
    setup: Annotated[str, typer.Option("--setup", help="eye-to-hand or eye-in-hand.")] = "eye-to-hand",
    serial: Annotated[str, typer.Option("--serial", help="Of the camera.")] = "unknown",
    poses: Annotated[int, typer.Option("--poses", min=5, max=60, help="Poses to visit on a bench.")] = 20,
    bench: BenchOption = "fake",
    seed: SeedOption = 0,
    yes: YesOption = False,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Find where the camera stands: from pictures <id>.png with poses.csv, or by visiting poses.

    poses.csv: id, x_m, y_m, z_m and qx, qy, qz, qw (or rx_rad, ry_rad, rz_rad), base_T_tcp.

    Examples:
      rig calibrate hand-eye --from samples --camera camera.yaml --target marker:60:DICT_4X4_50:0

      rig calibrate hand-eye --bench fake --poses 15

    """
    from calibration.boards import parse_target
    from calibration.camera_files import read_camera
    from calibration.hand_eye.samples import Setup
    from drivers.errors import InputError
    from rig.calibrate.bench_hand_eye import collect_hand_eye
    from rig.calibrate.hand_eye import hand_eye_from_folder

    if setup not in list(Setup):
        raise InputError(f"--setup '{setup}': use {' or '.join(Setup)}")
    wanted = parse_target(target)
    if source is None:
        folder = _out(out, bench)
        agree = (lambda _: True) if yes else ask
        outcome = collect_hand_eye(bench, seed, wanted, Setup(setup), poses, folder, agree, say)
    else:
        if camera_file is None:
            raise InputError(
                "hand-eye needs the camera's intrinsics: give --camera FILE (rig calibrate camera)"
            )
        known = read_camera(camera_file, None if serial == "unknown" else serial)
        outcome = hand_eye_from_folder(source, wanted, known, serial, Setup(setup))
    _file(outcome, out, bench, json)


@calibrate.command()
def markers(
    source: FromOption = None,
    ids: Annotated[tuple[int, int], typer.Option("--ids", help="The two marker ids.")] = (0, 1),
    dictionary: Annotated[
        str, typer.Option("--dictionary", help="OpenCV's name, or a file.")
    ] = "DICT_4X4_50",
    camera_file: CameraFile = None,
    pattern: Annotated[str, typer.Option("--pictures", help="Which pictures of the folder.")] = "*",
    serial: Annotated[str, typer.Option("--serial", help="Of the camera.")] = "unknown",
    object_name: Annotated[str, typer.Option("--object", help="Object to look at on a bench.")] = "wrench",
    bench: BenchOption = "fake",
    seed: SeedOption = 0,
    yes: YesOption = False,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Measure how well the two-marker angle is known, from 20 pictures or more of the object at rest.

    Without --from the bench's camera looks at an object in its place; nothing moves.

    Examples:
      rig calibrate markers --bench fake

      rig calibrate markers --from still --camera calibrations/camera-C1.yaml

    """
    from calibration.camera_files import read_camera
    from rig.calibrate.bench_camera import collect_markers
    from rig.calibrate.sensors import markers_from_folder

    if source is None:
        agree = (lambda _: True) if yes else ask
        outcome = collect_markers(bench, seed, object_name, _out(out, bench), agree)
    else:
        lens = None if camera_file is None else read_camera(camera_file).intrinsics
        outcome = markers_from_folder(source, pattern, ids, dictionary, lens, serial)
    _file(outcome, out, bench, json)


@calibrate.command()
def tactile(
    source: FromOption = None,
    mm_per_px: Annotated[
        tuple[float, float], typer.Option("--mm-per-px", help="Scale along x and y of the picture.")
    ] = (0.06, 0.06),
    serial: Annotated[str, typer.Option("--serial", help="Of the sensor.")] = "unknown",
    bench: BenchOption = "fake",
    seed: SeedOption = 0,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Fit how a gel's colours tell its slopes, from ball presses: background.png, catalog.csv, pictures.

    catalog.csv: image, diameter(mm). The balls are found by themselves. Without --from every
    fingertip of the bench is looked at untouched: its reference, and what changed since the last.

    Examples:
      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1

    """
    from rig.calibrate.bench_tactile import collect_references
    from rig.calibrate.sensors import tactile_from_folder

    if source is not None:
        _file(tactile_from_folder(source, serial, mm_per_px), out, bench, json)
        return
    filed = [_filed(outcome, out, bench) for outcome in collect_references(bench, seed, _out(out, bench))]
    if json:
        emit_json({"references": [each.figures for each in filed]})
    else:
        for each in filed:
            print(each.path, each.page, sep="\n")


@calibrate.command()
def gripper(
    source: FromOption = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the gripper.")] = "unknown",
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Make the table of opening over counts, from gripper.csv: counts, opening_mm, direction.

    force.csv (signal, force_n), where there is one, is made a table too.

    Examples:
      rig calibrate gripper --from measured --serial R3F-1

    """
    from rig.calibrate.tables import gripper_from_folder

    _file(gripper_from_folder(_folder(source, "gripper"), serial), out, "fake", json)


@calibrate.command()
def tcp(
    source: FromOption = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the tool.")] = "unknown",
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Find the tool's tip from poses.csv, taken while the tip rested in one hole at different tilts.

    Examples:
      rig calibrate tcp --from pivot

    """
    from rig.calibrate.tables import tcp_from_folder

    _file(tcp_from_folder(_folder(source, "tcp"), serial), out, "fake", json)


@calibrate.command()
def sync(
    source: FromOption = None,
    first: Annotated[str, typer.Option("--reference", help="Stream whose clock counts.")] = "robot",
    second: Annotated[str, typer.Option("--stream", help="Stream to be moved.")] = "camera",
    search: Annotated[float, typer.Option("--search", min=0.01, max=10, help="Largest offset, s.")] = 0.5,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Find the time offset between two recordings of one wiggle: <name>.csv with time_ns (or t_s) and value.

    Examples:
      rig calibrate sync --from wiggle --reference robot --stream camera

    """
    from rig.calibrate.tables import sync_from_folder

    _file(sync_from_folder(_folder(source, "sync"), first, second, search), out, "fake", json)


@calibrate.command()
def board(
    target: Annotated[
        str, typer.Argument(help="As --target of the other commands.")
    ] = "charuco:8x6:25:18:DICT_5X5_100",
    out: Annotated[Path | None, typer.Option("--out", help="SVG file.")] = None,
    json: JsonOption = False,
) -> None:
    """Draw a target to print at 100 %, with a bar of 100 mm to check with a ruler.

    Examples:
      rig calibrate board charuco:8x6:25:18:DICT_5X5_100 --out board.svg

    """
    from calibration.sheets import sheet_svg
    from calibration.store import write_text

    path = out or Path(f"{target.replace(':', '_')}.svg")
    write_text(path, sheet_svg(target))
    if json:
        emit_json({"target": target, "file": str(path)})
    else:
        print(path)


@calibrate.command()
def compare(
    one: Annotated[Path, typer.Argument(help="Calibration file.")],
    other: Annotated[Path, typer.Argument(help="Another of the same kind.")],
    json: JsonOption = False,
) -> None:
    """Say how far two calibrations differ where it matters: px over the picture, mm in the workspace.

    Examples:
      rig calibrate compare calibrations/camera-C1.yaml old/camera-C1.yaml

    """
    from rig.calibrate.compare import compare_files

    figures = compare_files(one, other)
    if json:
        emit_json(figures)
    else:
        for name, value in figures.items():
            print(f"{name}: {value}")


def _folder(source: Path | None, kind: str) -> Path:
    from drivers.errors import InputError

    if source is None:
        raise InputError(f"rig calibrate {kind}: this version solves recorded samples; give --from FOLDER")
    return source


def _out(out: Path | None, bench: str) -> Path:
    beside = Path(bench).parent if Path(bench).is_file() else Path()
    return out or beside / "calibrations"


def _file(outcome: "Outcome", out: Path | None, bench: str, json: bool) -> None:
    filed = _filed(outcome, out, bench)
    if json:
        emit_json(filed.figures)
    else:
        print(filed.path)
        print(filed.page)


def _filed(outcome: "Outcome", out: Path | None, bench: str) -> "Filed":
    from rig.calibrate.outcome import file_outcome

    filed = file_outcome(outcome, _out(out, bench))
    say(f"{'SIMULATED ' if outcome.simulated else ''}{outcome.kind}: {outcome.judgement}")
    for name, text in outcome.numbers.items():
        say(f"  {name}: {text}")
    for left_out in outcome.rejected:
        say(f"  left out {left_out.id}: {left_out.reason}")
    return filed
