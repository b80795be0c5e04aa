"""`rig objects`: which objects there are, and a file for one of your own."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rig.cli.common import BenchOption, JsonOption, ObjectsOption, emit_json, say
from rig.cli.helping import Commands

if TYPE_CHECKING:
    from protocols.grasps import GraspFile

objects = Commands(help="The objects that are grasped: the package's and your own.")


@objects.callback(invoke_without_command=True)
def _list(
    context: typer.Context, bench: BenchOption = "fake", own: ObjectsOption = None, json: JsonOption = False
) -> None:
    """List the objects that can be named with --object, and where each comes from.

    Your own lie in a folder `objects` beside the bench file, or in the folder given with --objects.

    Examples:
      rig objects

      rig objects --bench my_bench.toml --json

      rig objects new objects/my_box.toml

    """
    if context.invoked_subcommand is not None:
        return
    from protocols.grasps import load_grasp_files
    from rig.config import load_bench
    from rig.config.objects import objects_folder, read_objects

    load_bench(bench)
    folder = objects_folder(bench, own)
    found = [(each, "the package") for each in load_grasp_files().values()]
    found += [(each, str(path)) for path, each in (read_objects(folder) if folder else {}).items()]
    if json:
        emit_json({"objects": [_as_json(each, where) for each, where in found]})
        return
    from rig.cli.fitting import table_console

    table_console(to_stderr=False).print(_table(found))


@objects.command("new")
def new(file: Annotated[Path, typer.Argument(help="The file to write, as objects/my_box.toml.")]) -> None:
    """Write an object file that explains each of its keys; fill in yours, or have `rig teach` do it.

    Examples:
      rig objects new objects/my_box.toml

    """
    from rig.config.objects import new_object_file

    new_object_file(file)
    say(f"put in where it is grasped, then look at it with: rig objects --objects {file.parent}")
    print(file)


def _table(found: "list[tuple[GraspFile, str]]") -> Any:
    from rich.table import Table

    table = Table(title="objects; widths in mm")
    for heading in ("id", "name", "positions", "widths", "surfaces", "turns", "in trials", "from"):
        table.add_column(heading)
    for each, where in found:
        lifted = sum(position.lift_height_m > 0.0 for position in each.position)
        table.add_row(
            each.id,
            each.name,
            ", ".join(position.name for position in each.position),
            ", ".join(f"{1e3 * position.width_m:g}" for position in each.position),
            ", ".join(position.surface or "?" for position in each.position),
            str(len(each.orientations_deg)),
            f"{lifted} of {len(each.position)}",
            where,
        )
    return table


def _as_json(each: "GraspFile", where: str) -> dict[str, object]:
    return {**each.model_dump(mode="json"), "from": where}
