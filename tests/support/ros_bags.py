"""ROS bags of images, written by rosbags."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from drivers.clock import NS_PER_S
from drivers.images import encode_jpeg, encode_png

Image = NDArray[np.uint8]
TOPIC = "/digit_left/image_raw"
CLOCK_S = 1_700_000_000
"""When a bag receives its first message."""


def write_bag(
    path: Path,
    images: Mapping[str, Sequence[Image]],
    storage: str = "mcap",
    encoding: str = "rgb8",
    times_ns: Sequence[int] | None = None,
    sensors: Sequence[str] = ("tip",),
) -> Path:
    """Write a bag of images, by topic; return what to open.

    storage: mcap, sqlite3, or ros1. encoding: of raw images, or a format that contains jpeg or png. Pixels
    are written as they are, whatever the encoding. times_ns: stamps; headers without stamps if None. sensors:
    frame ids of the images, in turn.
    """
    store = get_typestore(Stores.ROS1_NOETIC if storage == "ros1" else Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.SQLITE3 if storage == "sqlite3" else StoragePlugin.MCAP
    with Writer1(path) if storage == "ros1" else Writer2(path, version=8, storage_plugin=plugin) as bag:
        for topic, frames in images.items():
            packed = "jpeg" in encoding or "png" in encoding
            kind = f"sensor_msgs/msg/{'CompressedImage' if packed else 'Image'}"
            connection = bag.add_connection(topic, kind, typestore=store)
            for number, image in enumerate(frames):
                time_ns, frame_id = times_ns[number] if times_ns else 0, sensors[number % len(sensors)]
                message = _message(store.types, kind, image, encoding, time_ns, frame_id)
                serialize = store.serialize_ros1 if storage == "ros1" else store.serialize_cdr
                bag.write(connection, (CLOCK_S + number) * NS_PER_S, serialize(message, kind))
    return path


def _message(
    types: Mapping[str, Any], kind: str, image: Image, encoding: str, time_ns: int, frame_id: str
) -> Any:
    fields: dict[str, Any] = {"stamp": types["builtin_interfaces/msg/Time"](*divmod(time_ns, NS_PER_S))}
    header = types["std_msgs/msg/Header"]
    fields |= {"frame_id": frame_id} | ({"seq": 0} if "seq" in header.__dataclass_fields__ else {})
    if kind.endswith("CompressedImage"):
        data = encode_png(image) if "png" in encoding else encode_jpeg(image)
        return types[kind](header(**fields), encoding, np.frombuffer(data, np.uint8))
    height, width, *_ = image.shape
    data = np.ascontiguousarray(image).ravel()
    return types[kind](header(**fields), height, width, encoding, 0, data.size // height, data)
