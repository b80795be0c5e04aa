"""Sources of live frames by what a person types: a serial, a device, an address, a file, or `fake`."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import DeviceError, InputError, no_such, without_passwords
from drivers.interfaces import FrameSource
from drivers.types import Image
from drivers.video.digit import Digit
from drivers.video.external_camera import ExternalCamera, GelSightMini, crop_gel
from drivers.video.files import RecordedStream
from drivers.video.reader import AddressedSource, FrameReader
from drivers.video.stream import RawFrame, decode_frame
from drivers.video.v4l2 import VideoNode, list_video_nodes
from fakes.devices.desk import Demonstration, DeskDigit
from rig.tactile.sample import TimedImage

SENSORS = ("digit", "gelsight-mini", "plain")
FAKE = "fake"
ADDRESS_RATE_HZ = 60.0
_SENSORS = f"a DIGIT's serial, /dev/videoN or its number, an MJPEG address (http://HOST:PORT/PATH), or {FAKE}"
PLAIN_RATE_HZ = 30.0
"""Asked of a camera that no driver of ours knows: most USB cameras have it."""


class Clip(Protocol):
    """Stored frames in order, as `rig.frames.series` reads them. rate_hz: their usual rate."""

    @property
    def rate_hz(self) -> float: ...

    def __iter__(self) -> Iterator[TimedImage]: ...


def live_sources(
    texts: Sequence[str],
    sensor: str | None,
    rate_hz: float | None,
    clips: Mapping[str, Clip] = MappingProxyType({}),
    clock: Clock | None = None,
) -> list[FrameSource]:
    """Return the source of each text; they are not connected yet.

    sensor: what the frames are of; None: a DIGIT for a serial or a device, frames as they come otherwise.
    rate_hz: asked of devices; None: the sensor's own. clips: the sources that are stored, by their texts,
    which are played at their own times. Raises `InputError` for what can never be opened, `DeviceError` for a
    device that is not there.
    """
    clock = clock or SystemClock()
    shown = Demonstration()
    made: list[FrameSource] = []
    for place, text in enumerate(texts):
        if text == FAKE:
            side = 1 if place == 0 else -1
            made.append(DeskDigit(f"SIM-DESK{place + 1}", side, shown, clock))
        elif text in clips:
            made.append(StoredClip(Path(text), sensor or "plain", clips[text], clock))
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
        return _make(kind, without_passwords(text), text, rate_hz or ADDRESS_RATE_HZ, clock)
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


class StoredClip(FrameReader):
    """A clip as a source that plays its frames at their own times. None is dropped. kind: of `SENSORS`."""

    def __init__(self, path: Path, kind: str, clip: Clip, clock: Clock) -> None:
        super().__init__(
            path.name, clip.rate_hz, lambda: _ClipStream(path, clip, clock), self._decode_as, clock
        )
        self._kind = kind
        self.waits = True

    def _decode_as(self, raw: RawFrame) -> tuple[Image, bytes | None]:
        image, jpeg = decode_frame(raw, None, upright=self._kind == "digit")
        return (crop_gel(image), None) if self._kind == "gelsight-mini" else (image, jpeg)


class _ClipStream(RecordedStream):
    def __init__(self, path: Path, clip: Clip, clock: Clock) -> None:
        super().__init__(path, clip.rate_hz, clock)
        self._frames, self._first_ns = iter(clip), 0

    def read(self) -> RawFrame:
        frame = next(self._frames, None)
        if frame is None:
            raise self._end_error()
        self._first_ns = self._first_ns if self._number else frame.time_ns
        number, due_ns = self._await_next((frame.time_ns - self._first_ns) / NS_PER_S)
        return RawFrame(self._clock.now_ns(), None, frame.image, due_ns, number)
