"""Connect a device for a block of a test."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar


class Device(Protocol):
    def connect(self) -> None: ...
    def disconnect(self) -> None: ...


D = TypeVar("D", bound=Device)


@contextmanager
def connected(device: D) -> Iterator[D]:
    """Connect, and disconnect at the end, also of a test that fails."""
    device.connect()
    try:
        yield device
    finally:
        device.disconnect()
