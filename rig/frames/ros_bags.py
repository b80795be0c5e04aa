"""Frames in a ROS bag, read without ROS: ROS 2 (MCAP or SQLite storage) and ROS 1.

sensor_msgs/Image and sensor_msgs/CompressedImage are read with their standard definitions, which are the same
in every ROS 2 distribution. In ROS 1 only the header differs. Definitions in the bag are not used, because
rosbags would generate code from them.

The size of a bag after decompression is checked before rosbags decompresses it without a limit. Compressed
are: the chunks of MCAP and of ROS 1 bags; whole files of ROS 2 bags (`.db3.zstd`), which are unpacked to
disk; single messages of ROS 2 bags. Formats: https://mcap.dev/spec, http://wiki.ros.org/Bags/Format/2.0.
"""

import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RigError, plural, unknown_name
from drivers.formats import MOST_PIXELS, check_pieces, in_number_order, quote, reason
from drivers.images import decode_image
from drivers.types import Image
from rig.config.extras import require_extra
from rig.sessions.files import MAGIC, ROS_BEGINNINGS, first_bytes

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

_ROS1, _ZSTD = b"#ROSBAG V2.0\n", b"\x28\xb5\x2f\xfd"
_MCAP_RECORD, _MCAP_CHUNK = struct.Struct("<BQ"), struct.Struct("<QQQII")
_CHUNK, _ROS1_CHUNK = 6, b"op=\x05"
_LENGTH = struct.Struct("<I")
_PART = re.compile(r"(.*)_[0-9]+(\.(?:mcap|db3|bag)(?:\.zstd)?)")
RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
ENCODINGS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
}
"""Bytes per pixel of the encodings that are read, and OpenCV's conversion to RGB.

Names: sensor_msgs/image_encodings.hpp, in lower case. 8UC3 is BGR, as OpenCV's images are.
"""


def require_rosbags() -> None:
    """Raise `InputError` if rosbags is not installed, with the command that installs it."""
    require_extra("rosbags", "ros2", "ROS bags need")


def find_topic(path: Path, topic: str | None) -> str:
    """Return `topic` if the bag has images on it; if it is None, the only topic of images in the bag.

    Raises `InputError` with the topics of the bag if there is no such topic, and for a damaged bag.
    """
    with _open_bag(path) as bag:
        if getattr(bag, "compression_mode", None) == "message":
            opened: Any = bag
            messages = (
                ("zstd", data)
                for storage in opened.storage.storages
                for _, _, data in storage.messages(storage.connections, None, None)
            )
            check_pieces(str(path), sum(file.stat().st_size for file in path.iterdir()), messages)
        topics = {each.topic: each.msgtype for each in bag.connections}
    images = sorted(each for each, kind in topics.items() if kind in (RAW, COMPRESSED))
    if not images:
        listed = f"only {', '.join(sorted(topics))}" if topics else "no topic at all"
        raise InputError(f"{path}: no topic of images, {listed}: record sensor_msgs/Image or CompressedImage")
    if topic is None and len(images) > 1:
        raise InputError(
            f"{path}: {len(images)} topics of images: choose one with --topic: {', '.join(images)}"
        )
    if topic is not None and topic not in images:
        raise unknown_name("topic of images", topic, images)
    return topic or images[0]


def rest_of_bag(path: Path) -> tuple[Path, ...]:
    """Return the other files of a split bag (name_0.mcap, name_1.mcap ...) of which one file is given."""
    name = _PART.fullmatch(path.name)
    if path.is_dir() or name is None:
        return ()
    others = (_PART.fullmatch(file.name) for file in path.parent.iterdir())
    same = [path.with_name(other[0]) for other in others if other and other.groups() == name.groups()]
    return tuple(in_number_order(file for file in same if file != path))


def bag_times(path: Path, topic: str) -> tuple[list[int], list[int]]:
    """Return the header stamps and the times of receipt of a topic's images, ns, in the order of the bag.

    Raises `InputError` if their headers name several frames, which are those of several sensors.
    """
    with _open_bag(path) as bag:
        deserialized = _deserializer(bag)
        messages = bag.messages(connections=_connections(bag, topic))
        stamps, received, sensors = [], [], dict[str, None]()
        for each, received_ns, data in messages:
            header = deserialized(data, each.msgtype).header
            stamp, sensors[header.frame_id] = header.stamp, None
            stamps.append(stamp.sec * NS_PER_S + stamp.nanosec)
            received.append(received_ns)
    if len(sensors) > 1:
        named = " and ".join(map(quote, list(sensors)[:2]))
        raise InputError(f"{path}: {topic} has images of two sensors, {named}: record a topic for each")
    return stamps, received


def bag_images(path: Path, topic: str) -> Iterator[Image | None]:
    """Yield a topic's images in the order of the bag, (H, W, 3) uint8 RGB; None if one cannot be decoded.

    Raises `InputError` for an unsupported encoding, for a topic without a complete image, and for a damaged
    bag.
    """
    count = decoded = 0
    kind = ""
    with _open_bag(path) as bag:
        deserialized = _deserializer(bag)
        for connection, _, data in bag.messages(connections=_connections(bag, topic)):
            message = deserialized(data, connection.msgtype)
            if connection.msgtype == COMPRESSED:
                kind, image = message.format, _compressed_image(message)
            else:
                kind, image = message.encoding, _raw_image(message, topic)
            count, decoded = count + 1, decoded + (image is not None)
            yield image
    if not decoded:
        raise InputError(
            f"{path}: {topic}: not one complete image in {plural(count, 'message')} ({quote(kind)}): record "
            "it again, as raw images, JPEG or PNG"
        )


def _connections(bag: "Reader1 | Reader2", topic: str) -> list[Any]:
    return [c for c in bag.connections if c.topic == topic and c.msgtype in (RAW, COMPRESSED)]


def _raw_image(message: Any, topic: str) -> Image | None:
    """Decode a raw image; None if its data are too few for its size."""
    encoding, height, width, step = message.encoding.lower(), message.height, message.width, message.step
    if encoding not in ENCODINGS:
        also = f"; publish {topic} again in one of them, or as JPEG (image_transport republish)"
        raise unknown_name("encoding of images", message.encoding[:40], ENCODINGS, also)
    size, conversion = ENCODINGS[encoding]
    complete = width * size <= step and height * step <= message.data.size
    if not 0 < height * width <= MOST_PIXELS or not complete:
        return None
    rows = message.data[: height * step].reshape(height, step)[:, : width * size]
    pixels = np.ascontiguousarray(rows).reshape(height, width, size)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def _compressed_image(message: Any) -> Image | None:
    """Decode a compressed image; None if it cannot be decoded.

    image_transport compresses a Bayer mosaic as it is, with a format such as "bayer_rggb8; jpeg compressed ".
    """
    source, _, packed = message.format.lower().partition(";")
    _, conversion = ENCODINGS.get(source, (1, None))
    if conversion is None or not source.startswith("bayer_") or packed.split()[1:] != ["compressed"]:
        return decode_image(message.data.tobytes())
    mosaic = decode_image(message.data.tobytes(), grey=True)
    return None if mosaic is None else np.asarray(cv2.cvtColor(mosaic, conversion), np.uint8)


def _deserializer(bag: "Reader1 | Reader2") -> Callable[[bytes, str], Any]:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.typesys import Stores, get_typestore

    if isinstance(bag, Reader1):
        return get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
    return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr


@contextmanager
def _open_bag(path: Path) -> "Iterator[Reader1 | Reader2]":
    """Open a bag. Raises `InputError` in place of any exception of rosbags for a damaged bag."""
    require_rosbags()
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    try:
        for file in [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]:
            facts = file.stat()
            _check_file(file, facts.st_size, facts.st_mtime_ns)
        with Reader1(path) if first_bytes(path).startswith(ROS_BEGINNINGS[0]) else Reader2(path) as bag:
            yield bag
    except RigError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: cannot be read as a ROS bag ({reason(error)}): copy it again, or repair an interrupted "
            "one with ros2 bag reindex (ROS 1: rosbag reindex; MCAP: mcap recover)"
        ) from error


@lru_cache(maxsize=64)
def _check_file(path: Path, size: int, changed_ns: int) -> None:
    """Check a file; an unchanged file that was accepted is not checked again."""
    with path.open("rb") as stream:
        begin = stream.read(len(_ROS1))
        if begin.startswith(MAGIC):
            check_pieces(str(path), size, _mcap_chunks(stream, size))
        elif begin == _ROS1:
            check_pieces(str(path), size, _ros1_chunks(stream, size))
        elif begin.startswith(_ZSTD):
            stream.seek(0)
            check_pieces(str(path), size, [("zstd", stream.read())])


def _mcap_chunks(stream: IO[bytes], size: int) -> Iterator[tuple[str, bytes]]:
    at = len(MAGIC)
    while at + _MCAP_RECORD.size <= size:
        stream.seek(at)
        kind, length = _MCAP_RECORD.unpack(stream.read(_MCAP_RECORD.size))
        at += _MCAP_RECORD.size + length
        if kind == _CHUNK and at <= size and length > _MCAP_CHUNK.size:
            record = stream.read(length)
            (name_length,) = _LENGTH.unpack_from(record, 28)
            yield record[32 : 32 + name_length].decode(errors="replace"), record[40 + name_length :]


def _ros1_chunks(stream: IO[bytes], size: int) -> Iterator[tuple[str, bytes]]:
    at = len(_ROS1)
    while at + _LENGTH.size <= size:
        stream.seek(at)
        header = stream.read(min(_LENGTH.unpack(stream.read(_LENGTH.size))[0], size))
        at += _LENGTH.size + len(header)
        data_length = _LENGTH.unpack(stream.read(_LENGTH.size))[0] if at + _LENGTH.size <= size else size
        at += _LENGTH.size
        if _ROS1_CHUNK in header and at + data_length <= size:
            kind = next((k for k in ("bz2", "lz4") if f"compression={k}".encode() in header), "")
            yield kind, stream.read(data_length)
        at += data_length
