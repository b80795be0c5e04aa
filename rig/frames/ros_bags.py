"""Frames in a ROS bag, read without ROS: ROS 2 (MCAP or SQLite storage) and ROS 1.

sensor_msgs/Image and sensor_msgs/CompressedImage are read with their standard definitions, which are the same
in every ROS 2 distribution. In ROS 1 only the header differs. Definitions in the bag are not used, because
rosbags would generate code from them.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RigError, counted, unknown_name
from drivers.formats import MOST_PIXELS, in_number_order, reason, shown
from drivers.images import decode_image
from drivers.types import Image
from rig.config.extras import require_extra
from rig.frames.bag_sizes import check_bag_size, check_message_sizes
from rig.sessions.files import ROS_BEGINNINGS, first_bytes

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

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
    with _opened(path) as bag:
        if getattr(bag, "compression_mode", None) == "message":
            check_message_sizes(path, bag)
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
    """Return the header stamps and the times of receipt of a topic's images, ns, in the order of the bag."""
    with _opened(path) as bag:
        deserialized = _deserializer(bag)
        messages = bag.messages(connections=_connections(bag, topic))
        times = [(_stamp_ns(deserialized(data, each.msgtype)), at_ns) for each, at_ns, data in messages]
    return [stamp for stamp, _ in times], [received for _, received in times]


def bag_images(path: Path, topic: str) -> Iterator[Image | None]:
    """Yield a topic's images in the order of the bag, (H, W, 3) uint8 RGB; None if one cannot be decoded.

    Raises `InputError` for an unsupported encoding, for a topic without a complete image, and for a damaged
    bag.
    """
    count = decoded = 0
    kind = ""
    with _opened(path) as bag:
        deserialized = _deserializer(bag)
        for connection, _, data in bag.messages(connections=_connections(bag, topic)):
            message = deserialized(data, connection.msgtype)
            if connection.msgtype == COMPRESSED:
                kind, image = message.format, decode_image(message.data.tobytes())
            else:
                kind, image = message.encoding, _raw_image(message, topic)
            count, decoded = count + 1, decoded + (image is not None)
            yield image
    if not decoded:
        raise InputError(
            f"{path}: {topic}: not one complete image in {counted(count, 'message')} ({shown(kind)}): record "
            "it again, as raw images, JPEG or PNG"
        )


def _connections(bag: "Reader1 | Reader2", topic: str) -> list[Any]:
    return [c for c in bag.connections if c.topic == topic and c.msgtype in (RAW, COMPRESSED)]


def _stamp_ns(message: Any) -> int:
    return message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec


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


def _deserializer(bag: "Reader1 | Reader2") -> Callable[[bytes, str], Any]:
    """Return the function that reads a message of a type."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.typesys import Stores, get_typestore

    if isinstance(bag, Reader1):
        return get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
    return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr


@contextmanager
def _opened(path: Path) -> "Iterator[Reader1 | Reader2]":
    """Open a bag. Raises `InputError` in place of any exception of rosbags for a damaged bag."""
    require_rosbags()
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    try:
        check_bag_size(path)
        with Reader1(path) if first_bytes(path).startswith(ROS_BEGINNINGS[0]) else Reader2(path) as bag:
            yield bag
    except RigError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: cannot be read as a ROS bag ({reason(error)}): copy it again, or repair an interrupted "
            "one with ros2 bag reindex (ROS 1: rosbag reindex; MCAP: mcap recover)"
        ) from error
