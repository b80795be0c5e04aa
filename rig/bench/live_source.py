"""Sources of live frames by what a person types: a serial, a device, an address, a file, or `fake`."""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import DeviceError, InputError, no_such, without_passwords
from drivers.formats import read_csv_rows, time_ns_in
from drivers.interfaces import FrameSource
from drivers.tally import LONGEST_STEP_NS
from drivers.video.digit import Digit
from drivers.video.external_camera import ExternalCamera, GelSightMini
from drivers.video.reader import AddressedSource
from drivers.video.v4l2 import VideoNode, list_video_nodes
from fakes.devices.desk import Demonstration, DeskDigit

SENSORS = ("digit", "gelsight-mini", "plain")
FAKE = "fake"
FILE_RATE_HZ = 60.0
"""Of a folder of images, as `rig estimate` assumes."""
LEAST_HZ = 0.1
"""Lowest frame rate of a clip in Hz, as for --fps."""
CLIP_FRAMES, CLIP_TIMES = "frames", "timestamps.csv"
"""Folder of the images of a clip, and table of their times, as in `rig.frames.clips`."""
_SENSORS = f"a DIGIT's serial, /dev/videoN or its number, an MJPEG address (http://HOST:PORT/PATH), or {FAKE}"
PLAIN_RATE_HZ = 30.0
"""Asked of a camera that no driver of ours knows: most USB cameras have it."""


def live_sources(
    texts: Sequence[str], sensor: str | None, rate_hz: float | None, clock: Clock | None = None
) -> list[FrameSource]:
    """Return the source of each text; they are not connected yet.

    sensor: what the frames are of; None: a DIGIT for a serial or a device, frames as they come otherwise.
    rate_hz: asked of devices, pace of files; None: the sensor's own, that of a video, the mean one of a clip
    with times, 60 for images. Raises `InputError` for what can never be opened, `DeviceError` for a device
    that is not there, `FormatError` for a damaged table of times.
    """
    clock = clock or SystemClock()
    shown = Demonstration()
    made: list[FrameSource] = []
    for place, text in enumerate(texts):
        if text == FAKE:
            side = 1 if place == 0 else -1
            made.append(DeskDigit(f"SIM-DESK{place + 1}", side, shown, clock))
        else:
            made.append(_source(text, sensor, rate_hz, clock))
    names = [source.serial for source in made]
    if len(set(names)) < len(names):
        raise InputError(f"{names[0]}: named twice: give two different sources")
    return made


def is_stored(text: str) -> bool:
    """Whether a text names an existing file or folder, not a sensor."""
    sensor = text == FAKE or text.isdecimal() or text.startswith("/dev/") or "://" in text
    return not sensor and Path(text).exists()


def serial_of(text: str) -> str | None:
    """Return the serial of the sensor that a text names; None for a source without one, such as a file."""
    if text == FAKE or "://" in text:
        return None
    node = f"/dev/video{text}" if text.isdecimal() else text
    if node.startswith("/dev/"):
        nodes = list_video_nodes()
        serials = [each.serial for each in nodes if each.device == node and each.serial]
        known = [each.serial for each in nodes]
        return serials[0] if serials and known.count(serials[0]) == 1 else None
    return None if is_stored(text) else text


def _source(text: str, sensor: str | None, rate_hz: float | None, clock: Clock) -> FrameSource:
    if text.isdecimal():
        text = f"/dev/video{text}"
    is_address, is_device, path = "://" in text, text.startswith("/dev/"), Path(text)
    if is_device:
        _check_device(path)
    kind = sensor or "plain"
    if is_address:
        return _make(kind, without_passwords(text), text, rate_hz or FILE_RATE_HZ, clock)
    if is_stored(text):
        frames = path / CLIP_FRAMES if (path / CLIP_FRAMES).is_dir() else path
        source = _make(kind, path.name, str(frames), rate_hz or _own_rate(frames), clock)
        source.waits = True
        return source
    if not is_device and ("/" in text or path.suffix):
        raise InputError(no_such(path, cure=f"give {_SENSORS}"))
    if not is_device:
        _check_device(Path(_node_of(text).device))
    # without an address it is found again by its serial when it is plugged in again
    return _make(sensor or "digit", text, text if is_device else None, rate_hz, clock)


def _make(kind: str, name: str, address: str | None, rate_hz: float | None, clock: Clock) -> AddressedSource:
    if kind == "digit":
        return Digit(name, rate_hz or 60.0, address=address, clock=clock)
    if kind == "gelsight-mini":
        return GelSightMini(name, address, rate_hz, clock)
    return ExternalCamera(name, address, rate_hz or PLAIN_RATE_HZ, clock=clock)


def _node_of(serial: str) -> VideoNode:
    """Return the device with a serial. Raises `InputError` with the list of those found."""
    nodes = list_video_nodes()
    found = [node for node in nodes if node.serial == serial]
    if len(found) == 1:
        return found[0]
    listed = ", ".join(f"{node.serial or 'no serial'} at {node.device}" for node in nodes) or "none"
    raise InputError(
        f"{serial}: {len(found) or 'no'} video devices have this serial; found: {listed}. Check the cable "
        f"and the serial, or give /dev/videoN, an MJPEG address, or {FAKE}"
    )


def _check_device(node: Path) -> None:
    """Raise `DeviceError` with the cure for a device node that is missing or may not be read."""
    if not node.exists():
        there = ", ".join(sorted(str(each) for each in Path("/dev").glob("video*"))) or "none"
        raise DeviceError(f"{node}: there is no such device (found: {there}); check the cable and the number")
    if not os.access(node, os.R_OK | os.W_OK):
        raise DeviceError(
            f"{node}: you may not read it: install the rules that rig bench udev prints, or join the group "
            "'video' (sudo usermod -aG video $USER, then log in again)"
        )


def _own_rate(path: Path) -> float:
    """Return the frame rate of a video, or the mean one of a clip with times, in Hz; else `FILE_RATE_HZ`.

    Pauses of a clip do not count, as those of a sensor that was unplugged. Raises `InputError` for times that
    cannot be s.
    """
    if path.is_dir():
        times = path.parent / CLIP_TIMES
        if path.name != CLIP_FRAMES or not times.is_file():
            return FILE_RATE_HZ
        rows = read_csv_rows(times, ("t_s",))
        times_ns = [time_ns_in(row, "t_s", f"{times}: line {line}") for line, row in rows]
        steps_ns = [later - earlier for earlier, later in pairwise(times_ns)]
        steps_ns = [step_ns for step_ns in steps_ns if step_ns <= LONGEST_STEP_NS] or steps_ns
        if sum(steps_ns) <= 0:
            return FILE_RATE_HZ
        rate_hz = len(steps_ns) * NS_PER_S / sum(steps_ns)
        if rate_hz < LEAST_HZ:
            raise InputError(
                f"{times}: {rate_hz:.2g} frames per second by its times: are they in ms? Give times in s, or "
                "a frame rate (--fps)"
            )
        return rate_hz
    capture = cv2.VideoCapture(str(path))
    try:
        rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
    finally:
        capture.release()
    return rate_hz if 0.0 < rate_hz <= 1000.0 else FILE_RATE_HZ
