"""Sensors are found by serial: in a table of devices, and with udev on an emulated machine."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from drivers.video.v4l2 import VideoNode, find_video_node, on_same_bus

TABLE = [
    VideoNode("/dev/video0", "D20001", "DIGIT", "0200", "usb1", "1-2"),
    VideoNode("/dev/video2", "D20002", "DIGIT", "0200", "usb1", "1-3"),
    VideoNode("/dev/video4", "C1", "Webcam", "0010", "usb3", "3-1"),
    VideoNode("/dev/video6", "TWIN"),
    VideoNode("/dev/video7", "TWIN"),
]


def test_video_node_is_found_by_its_serial_or_its_absence_reported() -> None:
    assert find_video_node("D20002", TABLE).device == "/dev/video2"
    for serial, nodes, said in (
        ("D9", TABLE, r"D9: not plugged in; udev lists D20001 at /dev/video0, D20002"),
        ("D9", [], "no video device"),
        ("TWIN", TABLE, "2 devices have this serial"),
    ):
        with pytest.raises(DeviceError, match=said):
            find_video_node(serial, nodes)


def test_devices_on_the_same_bus_are_listed() -> None:
    assert on_same_bus(TABLE[0], TABLE) == [TABLE[1]]
    assert on_same_bus(TABLE[3], TABLE) == []


def usb_device(port: str) -> str:
    """A USB device in umockdev's notation."""
    path = f"/devices/pci0000:00/0000:00:14.0/usb1/{port}"
    return f"P: {path}\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: BUSNUM=001\n"


def video_node(name: str, serial: str, revision: str, capabilities: str, port: str) -> str:
    """A video node of a USB device."""
    path = f"/devices/pci0000:00/0000:00:14.0/usb1/{port}/{port}:1.0/video4linux/{name}"
    properties = {
        "DEVNAME": f"/dev/{name}",
        "SUBSYSTEM": "video4linux",
        "ID_MODEL": "DIGIT",
        "ID_SERIAL_SHORT": serial,
        "ID_REVISION": revision,
        "ID_V4L_CAPABILITIES": capabilities,
    }
    return f"P: {path}\nN: {name}\n" + "".join(f"E: {key}={value}\n" for key, value in properties.items())


@pytest.mark.skipif(shutil.which("umockdev-run") is None, reason="umockdev is not installed")
def test_only_capture_nodes_of_udev_are_used(tmp_path: Path) -> None:
    pytest.importorskip("pyudev")
    machine = tmp_path / "machine.umockdev"
    parts = [
        usb_device("1-2"),
        video_node("video0", "D20001", "0200", ":capture:", "1-2"),
        video_node("video1", "D20001", "0200", ":", "1-2"),
        usb_device("1-3"),
        video_node("video2", "D20002", "0101", ":capture:", "1-3"),
    ]
    machine.write_text("\n".join(parts))
    code = (
        "from drivers.video.v4l2 import list_video_nodes as nodes\n"
        "for n in sorted(nodes(), key=lambda n: n.device):\n"
        "    print(n.device, n.serial, n.model, n.revision, n.usb_bus, n.usb_port)"
    )
    command = ["umockdev-run", "-d", str(machine), "--", sys.executable, "-c", code]
    seen = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert seen.stdout.splitlines() == [
        "/dev/video0 D20001 DIGIT 0200 usb1 1-2",
        "/dev/video2 D20002 DIGIT 0101 usb1 1-3",
    ], seen.stderr
