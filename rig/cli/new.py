"""`rig new`: a package of one's own, to begin with."""

import keyword
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import say

TEMPLATES = Path(__file__).parents[1] / "templates"


class Kind(StrEnum):
    """What it is to be."""

    ESTIMATOR = "estimator"
    SENSOR = "sensor"
    CAMERA = "camera"
    ARM = "arm"
    GRIPPER = "gripper"


def new(
    kind: Annotated[Kind, typer.Argument(help="What it is to be.")],
    folder: Annotated[
        Path, typer.Argument(help="A folder that is made; its name becomes the module's, as my_gel.")
    ],
) -> None:
    """Write a small package of your own: an estimator, sensor, camera, arm or gripper that runs as it is.

    It holds one module of some 40 lines to change, a pyproject.toml and a README that says how to install it,
    name it and check it.

    Examples:
      rig new estimator my_rotation

      rig new sensor my_gel

    """
    _check_name(folder)
    _write(TEMPLATES / kind, folder, f"my_{kind}")
    say(f"change {folder / folder.name}.py; README.md beside it says how to install, name and check it")
    print(folder)


def _check_name(folder: Path) -> None:
    from drivers.errors import InputError

    name = folder.name
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{folder}: '{name}' is no name of a module: give one of a-z, 0-9 and _, as my_gel")
    if find_spec(name) is not None:
        raise InputError(
            f"{folder}: a module '{name}' is here already, and would hide this one: give another"
        )


def _write(template: Path, folder: Path, name: str) -> None:
    from drivers.errors import InputError

    try:
        folder.mkdir(parents=True)
        for file in sorted(template.iterdir()):
            if file.is_file():
                named = file.name.replace(name, folder.name)
                (folder / named).write_text(_renamed(file.read_text(), name, folder.name))
    except FileExistsError as error:
        raise InputError(f"{folder} exists already: give another name, or move it aside") from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error


def _renamed(text: str, before: str, after: str) -> str:
    """The text with a module's name changed, and the names of class and package that follow from it."""
    for spelled in (lambda name: name, lambda name: name.replace("_", "-"), _class_name):
        text = text.replace(spelled(before), spelled(after))
    return text


def _class_name(module: str) -> str:
    return "".join(part.title() for part in module.split("_"))
