"""`rig calibrate`: calibration files and pages from recorded samples, or from the bench."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.calibrate import cameras, sensors
from rig.cli.common import emit_json
from rig.cli.helping import Commands
from rig.cli.options import JsonOption
from rig.cli.places import file_place

calibrate = Commands(
    no_args_is_help=True,
    help="Turn samples into calibration files with their uncertainty, a verdict and a page.\n\n"
    "Samples are collected on --bench, by a protocol that asks before it moves, or read with --from FOLDER "
    "(each command's help says what it holds). Files go to --out, by default calibrations/ beside the bench "
    "file (for the built-in benches: here), where rig trial and rig record find and use them.",
)
for command in (cameras.camera, cameras.hand_eye, cameras.markers):
    calibrate.command()(command)
for command in (sensors.tactile, sensors.gripper, sensors.tcp, sensors.sync):
    calibrate.command()(command)


@calibrate.command()
def board(
    target: Annotated[
        str, typer.Argument(help="As --target of the other commands.")
    ] = "charuco:8x6:25:18:DICT_5X5_100",
    out: Annotated[
        Path | None, typer.Option("--out", help="File ending in .svg or .pdf.", callback=file_place)
    ] = None,
    json: JsonOption = False,
) -> None:
    """Draw a target to print at 100 %, with a bar of 100 mm to check with a ruler.

    Measure one side after printing: what it measures goes into the target's name.

    Examples:
      rig calibrate board charuco:8x6:25:18:DICT_5X5_100 --out board.pdf

      rig calibrate board marker:60:DICT_4X4_50:0 --out marker.svg

    """
    from calibration.store import write_bytes
    from calibration.targets.sheets import sheet_svg
    from drivers.errors import InputError
    from rig.calibrate.figures import sheet_pdf

    path = out or Path(f"{target.replace(':', '_')}.svg")
    makers = {".svg": lambda: sheet_svg(target).encode(), ".pdf": lambda: sheet_pdf(target)}
    if path.suffix.lower() not in makers:
        raise InputError(f"--out {path}: give a file ending in .svg or .pdf")
    write_bytes(path, makers[path.suffix.lower()]())
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
