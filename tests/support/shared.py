"""Recorded sessions that all workers of a test run read, each recorded once."""

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest

Make = Callable[[Path], object]


def made_once(factory: pytest.TempPathFactory, name: str, make: Make) -> Path:
    """Return a folder that the first worker fills by `make(folder)` and the others wait for.

    Tests read it and write only into copies of it.
    """
    base = factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    finished = shared / f"{name}-finished"
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not finished.exists():
            make(shared / name)
            finished.touch()
    return shared / name
