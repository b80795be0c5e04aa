"""`rig calibrate`: write calibration files and pages, from recorded samples or on the bench."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.calibrate import cameras, sensors
from rig.cli.common import emit_json
from rig.cli.helping import Commands
from rig.cli.options import JsonOption
from rig.declared import file_place

calibrate = Commands(
    no_args_is_help=True,
    help="Calibrate cameras, sensors, gripper, tool and clocks; write files with uncertainty and a page.\n\n"
    "Samples are collected on --bench, with a question before each motion, or read with --from FOLDER (the "
    "help of each command describes the folder). Results go to --out, by default calibrations/ beside the "
    "bench file (for a built-in bench, in the current folder), where rig trial and rig record find them.",
)
for command in (cameras.camera, cameras.hand_eye, cameras.markers):
    calibrate.command()(command)
for command in (sensors.tactile, sensors.gripper, sensors.tcp, sensors.sync):
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
    other: Annotated[Path, typer.Argument(help="Calibration file of the same kind to compare with.")],
    json: JsonOption = False,
) -> None:
    """Print how far two calibrations differ, in px over the picture or in mm over the workspace.

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
