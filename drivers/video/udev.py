"""Which video devices are plugged in: serial, node and USB bus, from udev.

A UVC camera has a capture node and a metadata node, and their numbers change when it is plugged
in again; so a camera is chosen by serial and by what its node can do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.errors import DeviceError


@dataclass(frozen=True, slots=True)
class VideoNode:
    """A node that captures. revision: of the firmware, as USB gives it ("0200" is 2.00).

    usb_bus: the root hub it hangs on, which shares its bandwidth; usb_port: its place there.
    """

    device: str
    serial: str
    model: str = ""
    revision: str = ""
    usb_bus: str = ""
    usb_port: str = ""


Discover = Callable[[], Sequence[VideoNode]]


def list_video_nodes() -> list[VideoNode]:
    """Ask udev for the video devices that capture. Raises `DeviceError` where there is no udev."""
    try:
        import pyudev
    except ImportError as error:
        raise DeviceError(
            f"video devices: udev cannot be asked ({error}); give the device's address"
        ) from error
    devices = pyudev.Context().list_devices(subsystem="video4linux")
    return [_node(device) for device in devices if _captures(device)]


def find_video_node(serial: str, nodes: Sequence[VideoNode]) -> VideoNode:
    """Return the one node with this serial. Raises `DeviceError` for none, and for more than one."""
    found = [node for node in nodes if node.serial == serial]
    if len(found) == 1:
        return found[0]
    if found:
        where = ", ".join(node.device for node in found)
        raise DeviceError(f"{serial}: {len(found)} devices have this serial ({where}); unplug all but one")
    there = ", ".join(f"{node.serial} at {node.device}" for node in nodes) or "none at all"
    raise DeviceError(f"{serial}: not plugged in; udev lists {there}; check its cable and the serial")


def on_same_bus(node: VideoNode, nodes: Sequence[VideoNode]) -> list[VideoNode]:
    """The other nodes that share a node's USB bus."""
    return [other for other in nodes if other.usb_bus == node.usb_bus != "" and other.device != node.device]


def _captures(device: Any) -> bool:
    """By udev's own probe (v4l_id); by the node's index where that did not run."""
    able = device.properties.get("ID_V4L_CAPABILITIES")
    if able is not None:
        return ":capture:" in able
    index = device.attributes.get("index")
    return index is None or index.strip() == b"0"


def _node(device: Any) -> VideoNode:
    properties = device.properties
    bus, port = _usb_place(device)
    return VideoNode(
        device=device.device_node or "",
        serial=properties.get("ID_SERIAL_SHORT", ""),
        model=properties.get("ID_MODEL", ""),
        revision=properties.get("ID_REVISION", ""),
        usb_bus=bus,
        usb_port=port,
    )


def _usb_place(device: Any) -> tuple[str, str]:
    """The root hub ("usb1") and the port ("1-2.3") of a device; empty where it is not on USB."""
    parent = device.find_parent("usb", "usb_device")
    if parent is None:
        return "", ""
    port = parent.sys_name
    return f"usb{port.split('-')[0]}", port
