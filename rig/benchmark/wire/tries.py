"""Again what a busy computer has spoilt: programs and lifts in real time that end before their moment."""

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import DeviceError

TRIES = 3

Result = TypeVar("Result")


def tried(do: Callable[[], Result], before_again: Callable[[], str] = lambda: "") -> Result:
    """Do it, and again where it raised `DeviceError`, which is raised where it does so each time.

    before_again: puts things in order; it returns why that cannot be done, if so, and then nothing is tried
    again.
    """
    for _ in range(TRIES - 1):
        try:
            return do()
        except DeviceError:
            if before_again():
                raise
    return do()
