"""Load user-defined classes by name: `package.module:Class`, or the name of an entry point.

A class is imported only after the user has named it. The list of installed classes comes from package
metadata alone.
"""

import importlib
import os
import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from drivers.errors import InputError, OperatorStopError

CLASS_NAME = r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*"
"""`package.module:Class`, as a regular expression."""


@dataclass(frozen=True, slots=True)
class InstalledClass:
    """A class of an installed package. name: to give on the command line. target: `package.module:Class`."""

    name: str
    target: str
    distribution: str


def is_class_name(name: str) -> bool:
    """Whether a name has the form `package.module:Class`."""
    return re.fullmatch(CLASS_NAME, name) is not None


def installed_classes(group: str) -> tuple[InstalledClass, ...]:
    """Return the classes that installed packages offer in an entry-point group; nothing is imported."""
    found = sorted(entry_points(group=group), key=lambda point: (point.name, point.value))
    return tuple(InstalledClass(point.name, point.value, _distribution(point)) for point in found)


def named_class(name: str, what: str, group: str | None = None) -> type[Any]:
    """Import a class by its name and return it.

    name: `package.module:Class`, or, with a group, the name of an entry point. what: the kind of class for
    messages, as "estimator". Modules are also looked up in the folder in which the program was started.
    Raises `InputError` if there is no such class or its import fails.
    """
    return _imported(name if group is None else _target(name, what, group), what)


def _target(name: str, what: str, group: str) -> str:
    if is_class_name(name):
        return name
    targets = {found.target for found in installed_classes(group) if found.name == name}
    if len(targets) > 1:
        raise InputError(
            f"{what} '{name}': several installed packages offer this name; give one of "
            f"{', '.join(sorted(targets))}"
        )
    if not targets:
        raise InputError(f"{what} '{name}': no installed package offers it; give package.module:Class")
    return targets.pop()


@cache
def _imported(target: str, what: str) -> type[Any]:
    if not is_class_name(target):
        raise InputError(f"{what} '{target}': give package.module:Class, as my_lab.rotation:MyEstimator")
    module_name, _, class_name = target.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last, so that a file there does not hide an installed package
    try:
        module = importlib.import_module(module_name)
    except OperatorStopError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"{what} '{target}': importing {module_name} failed ({type(error).__name__}: {error}); install "
            "its package beside the rig, or start the rig in the folder that holds the module"
        ) from error
    found = getattr(module, class_name, None)
    if not isinstance(found, type):
        seen = "has no such name" if found is None else f"has a {type(found).__name__} of that name"
        raise InputError(f"{what} '{target}': {module_name} {seen}; give the name of a class in it")
    return found


def _distribution(point: EntryPoint) -> str:
    return "" if point.dist is None else f"{point.dist.name} {point.dist.version}"
