"""Check output paths before any work, so that no results are computed for an unwritable path."""

import os
from pathlib import Path

from drivers.errors import InputError


def file_place(path: Path | None) -> Path | None:
    """Return the path of a file. Raises `InputError` if no file can be written there."""
    if path is None:
        return None
    if path.exists() and not path.is_file():
        raise InputError(
            f"{path}: is {'a folder' if path.is_dir() else 'not a file'}; give the name of a file"
        )
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; create it, or choose another path")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise InputError(f"{path}: cannot be written; choose another path")
    return path


def folder_place(path: Path | None) -> Path | None:
    """Return the path of a folder that exists or can be created. Raises `InputError` if it cannot."""
    if path is None:
        return None
    there = next(place for place in (path.absolute(), *path.absolute().parents) if os.path.lexists(place))
    if not there.is_dir():
        raise InputError(f"{path}: {there} is a file; give a folder")
    if not os.access(there, os.W_OK):
        raise InputError(f"{path}: cannot be written; choose another folder")
    return path
