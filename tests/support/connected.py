"""Connect a device for a block of a test."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

Device = TypeVar("Device")


@contextmanager
def connected(device: Device) -> Iterator[Device]:
    """Connect a device, and disconnect it at the end, also of a test that fails."""
    device.connect()
    try:
        yield device
    finally:
        device.disconnect()
