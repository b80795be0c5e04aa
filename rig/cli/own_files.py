"""`rig bench`, `rig objects`, `rig new`: write files and packages of a lab's own; list the objects."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from rig.cli.common import emit_json, say
from rig.cli.helping import Commands
from rig.cli.options import BenchOption, JsonOption, ObjectsOption

bench = Commands(no_args_is_help=True, help="Write a bench file, which describes the devices of a bench.")
objects = Commands(help="List the objects that can be grasped; write an object file of your own.")
Kind = Literal["lab", "lerobot"]


@bench.command("new")
def new_bench(file: Annotated[Path, typer.Argument(help="File to write, as my_bench.toml.")]) -> None:
    """Write a template of a bench file, in which comments explain every key.

    Examples:
      rig bench new my_bench.toml
      rig doctor --bench my_bench.toml
    """
    from rig.config.load import new_bench_file

    new_bench_file(file)
    say(f"replace each value that begins with ENTER, then run: rig doctor --bench {file}")
    print(file)


@bench.command("udev")
def udev() -> None:
    """Print udev rules that give access and fixed names to the sensors and the gripper's serial adapter.

    Examples:
      rig bench udev | sudo tee /etc/udev/rules.d/70-slip-rig.rules
    """
    from importlib.resources import files

    print(files("rig.bench").joinpath("70-slip-rig.rules").read_text(encoding="utf-8"), end="")


@objects.callback(invoke_without_command=True)
def _list_objects(
    context: typer.Context, bench: BenchOption = "fake", own: ObjectsOption = None, json: JsonOption = False
) -> None:
    """List the objects; the files of a lab's own are in the folder of --objects."""
    if context.invoked_subcommand is not None:
        return
    from protocols.grasps import load_grasp_files
    from rig.config import load_bench
    from rig.config.objects import objects_folder, read_objects
    from rig.terminal.tables import console_table, table_console

    load_bench(bench)
    folder = objects_folder(bench, own)
    found = [(each, "the package") for each in load_grasp_files().values()]
    found += [(each, str(path)) for path, each in (read_objects(folder) if folder else {}).items()]
    if json:
        listed = [{**each.model_dump(mode="json"), "from": where} for each, where in found]
        emit_json({"objects": listed})
        return
    rows = [
        (
            each.id,
            each.name,
            ", ".join(position.name for position in each.position),
            ", ".join(f"{1e3 * position.width_m:g}" for position in each.position),
            ", ".join(position.surface or "?" for position in each.position),
            str(len(each.orientations_deg)),
            f"{sum(position.lift_height_m > 0.0 for position in each.position)} of {len(each.position)}",
            where,
        )
        for each, where in found
    ]
    columns = ("id", "name", "positions", "widths", "surfaces", "turns", "in trials", "from")
    table_console().print(console_table(columns, rows, range(len(columns)), "objects; widths in mm"))


@objects.command("new")
def new_object(
    file: Annotated[Path, typer.Argument(help="File to write, as objects/my_box.toml.")],
) -> None:
    """Write a template of an object file, in which comments explain every key.

    Fill in the values, or teach the grasp positions at the bench with `rig teach`.

    Examples:
      rig objects new objects/my_box.toml
    """
    from rig.config.objects import new_object_file

    new_object_file(file)
    say(f"fill in the grasp positions, then check the file with: rig objects --objects {file.parent}")
    print(file)


def new(
    kind: Annotated[Kind, typer.Argument(help="Kind of package.")],
    folder: Annotated[Path, typer.Argument(help="New folder; the module gets its name, as my_gel.")],
) -> None:
    """Write a template package of your own estimator, sensor, camera, arm and gripper, which runs unchanged.

    The kind lerobot is a LeRobot plug-in, with tactile sensors as cameras and the angle as an observation.

    The package has one module, a pyproject.toml, and a README with the commands to install, use and check it.

    Examples:
      rig new lab my_lab
      rig new lerobot lerobot_camera_my_gel
    """
    from rig.config.new_package import write_package

    write_package(kind, folder)
    say(f"change {folder / folder.name}.py; README.md beside it explains how to install, use and check it")
    print(folder)
