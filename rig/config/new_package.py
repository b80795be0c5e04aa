"""Create a package for a lab's own class from a template: an estimator, a driver, or a LeRobot plug-in."""

import keyword
from importlib.util import find_spec
from pathlib import Path

from drivers.errors import InputError

TEMPLATES = Path(__file__).parents[1] / "templates"
PREFIXES = {"lerobot": "lerobot_camera_"}
"""Required prefix of a package name, by kind: LeRobot finds plug-ins by it."""


def write_package(kind: str, folder: Path) -> None:
    """Write the template of a kind into a new folder; module, class and package are named after the folder.

    Raises `InputError` if the name is not a valid module name, lacks the prefix of its kind, is taken, or if
    the folder cannot be written.
    """
    _check_name(folder, PREFIXES.get(kind, ""))
    _write(TEMPLATES / kind, folder, f"my_{kind}")


def _check_name(folder: Path, prefix: str) -> None:
    name = folder.name
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{folder}: '{name}' is not a module name: use only a-z, 0-9 and _, as my_gel")
    if not name.startswith(prefix) or name == prefix:
        raise InputError(f"{folder}: the name must begin with {prefix}, as {prefix}my_gel")
    if find_spec(name) is not None:
        raise InputError(
            f"{folder}: a module '{name}' exists already, and would hide this one: give another name"
        )


def _write(template: Path, folder: Path, name: str) -> None:
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
    """Replace a module's name in a text, and the class and package names derived from it."""
    for spelled in (lambda name: name, lambda name: name.replace("_", "-"), _class_name):
        text = text.replace(spelled(before), spelled(after))
    return text


def _class_name(module: str) -> str:
    return "".join(part.title() for part in module.split("_"))
