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
    name, prefix, template = folder.name, PREFIXES.get(kind, ""), f"my_{kind}"
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{folder}: '{name}' is not a module name: use only a-z, 0-9 and _, as my_gel")
    if not name.startswith(prefix) or name == prefix:
        raise InputError(f"{folder}: the name must begin with {prefix}, as {prefix}my_gel")
    if find_spec(name) is not None:
        raise InputError(
            f"{folder}: a module '{name}' exists already, and would hide this one: give another name"
        )
    try:
        folder.mkdir(parents=True)
        for file in sorted(each for each in (TEMPLATES / kind).iterdir() if each.is_file()):
            text = file.read_text()
            for before, after in zip(_spellings(template), _spellings(name), strict=True):
                text = text.replace(before, after)
            (folder / file.name.replace(template, name)).write_text(text)
    except FileExistsError as error:
        raise InputError(f"{folder} exists already: give another name, or move it aside") from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error


def _spellings(module: str) -> tuple[str, str, str]:
    """Return a module's name, and the package and class names derived from it."""
    return module, module.replace("_", "-"), "".join(part.title() for part in module.split("_"))
