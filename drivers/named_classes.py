"""Load user-defined classes by name: `package.module:Class`, or the name of an entry point.

A class is imported only after the user has named it. The list of installed classes comes from package
metadata alone.
"""

import importlib
import os
import re
import sys
import sysconfig
import traceback
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from drivers.errors import InputError, OperatorStopError, nearest

CLASS_NAME = r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*"
"""`package.module:Class`, as a regular expression."""

_RIG = Path(__file__).resolve().parents[1]
_LIBRARIES = (
    "<frozen",
    f"{sysconfig.get_path('stdlib')}{os.sep}",
    *(f"{_RIG}{os.sep}{name}{os.sep}" for name in ("rig", "drivers", "fakes", "calibration", "protocols")),
)
"""Beginnings of the files whose lines are not shown as the place of an error."""
LONGEST_MESSAGE, LONGEST_LINE = 200, 80
"""Longest shown text of an exception and line of code, in characters; longer ones are cut."""


def is_class_name(name: str) -> bool:
    """Whether a name has the form `package.module:Class`."""
    return re.fullmatch(CLASS_NAME, name) is not None


def installed_classes(group: str) -> list[EntryPoint]:
    """Return the classes that installed packages offer in an entry-point group; nothing is imported.

    name: to give on the command line. value: `package.module:Class`.
    """
    return sorted(entry_points(group=group), key=lambda point: (point.name, point.value))


def raised_text(error: BaseException) -> str:
    """Return an exception of user-defined code as text, with the file, line and line of code that raised it.

    The place is the innermost one outside the rig, Python and installed packages, if there is one.
    """
    text = f"{type(error).__name__}: {error}"[:LONGEST_MESSAGE]
    if isinstance(error, SyntaxError):
        place = (error.filename, error.lineno, error.text) if error.filename else None
        text = f"{type(error).__name__}: {error.msg}"
    else:
        called = traceback.extract_tb(error.__traceback__)
        frames = [at for at in called if not at.filename.startswith(_LIBRARIES)]
        own = [at for at in frames if not {"site-packages", "dist-packages"} & set(Path(at.filename).parts)]
        at = own[-1] if own else next(iter(frames), None)
        place = at and (at.filename, at.lineno, at.line)
    if place is None:
        return text
    file, line, code = place
    return f"{text} ({file}, line {line}: {(code or '').strip()[:LONGEST_LINE]})"


def file_hint(name: str) -> str:
    """Return advice for a class that is named by its file, as `lab/mine.py:Mine`; "" for other names."""
    file, _, class_name = name.rpartition(":") if ":" in name else (name, "", "Class")
    if not file.endswith(".py"):
        return ""
    path = Path(file)
    seen = "" if path.is_file() else f"there is no file {path}; "
    start = "" if path.parent == Path() else f" and start the rig in {path.parent}"
    return f"; {seen}give module:Class without .py, as {path.stem}:{class_name}{start}"


def named_class(name: str, what: str, group: str | None = None) -> type[Any]:
    """Import a class by its name and return it.

    name: `package.module:Class`, or, with a group, the name of an entry point. what: the kind of class for
    messages, as "estimator". Modules are also looked up in the folder in which the program was started.
    Raises `InputError` if there is no such class or its import fails.
    """
    return _import_class(name if group is None else _target(name, what, group), what)


def _target(name: str, what: str, group: str) -> str:
    if is_class_name(name):
        return name
    targets = {found.value for found in installed_classes(group) if found.name == name}
    if len(targets) > 1:
        raise InputError(
            f"{what} '{name}': several installed packages offer this name; give one of "
            f"{', '.join(sorted(targets))}"
        )
    if not targets:
        hint = file_hint(name) or "; give package.module:Class"
        raise InputError(f"{what} '{name}': no installed package offers it{hint}")
    return targets.pop()


@cache
def _import_class(target: str, what: str) -> type[Any]:
    hint = file_hint(target)
    if not is_class_name(target) or hint:
        hint = hint or "; give package.module:Class, as my_lab.rotation:MyEstimator"
        raise InputError(f"{what} '{target}' is not the name of a class{hint}")
    module_name, _, class_name = target.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last, so that a file there does not hide an installed package
    try:
        module = importlib.import_module(module_name)
    except OperatorStopError:
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module_name}.".startswith(f"{error.name}."):
            seen = (
                f"there is no module {error.name}; install its package beside the rig, or start the rig in "
                "the folder that holds the module"
            )
        else:
            seen = f"importing {module_name} failed ({raised_text(error)}); correct it"
        raise InputError(f"{what} '{target}': {seen}") from error
    found = getattr(module, class_name, None)
    if not isinstance(found, type):
        seen = "has no such name" if found is None else f"has a {type(found).__name__} of that name"
        classes = [
            name
            for name, value in vars(module).items()
            if isinstance(value, type) and value.__module__ == module_name
        ]
        listed = f"; its classes: {', '.join(classes)}" if classes else "; give the name of a class in it"
        raise InputError(f"{what} '{target}': {module_name} {seen}{nearest(class_name, classes)}{listed}")
    return found
