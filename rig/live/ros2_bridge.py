"""Live angles, alarms and images as ROS 2 topics over DDS. ROS need not be installed.

ROS 2 nodes receive them because the bridge follows the conventions of ROS 2 on DDS (ROS 2 design, "Topic and
Service name mapping to DDS"; REP 2016): topics begin with `rt/`, types are named
`package::msg::dds_::Name_`, messages are plain CDR, and the endpoint's user data has the type's hash.
"""

import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from drivers.images import with_jpeg
from rig.live.desk_sensor import Reading
from rig.live.feed import OBJECT

DEPTH = 10
"""Number of messages that are kept for a slow receiver, as by default in ROS 2."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Bool(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    """std_msgs/Bool."""

    data: bool


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """sensor_msgs/JointState."""

    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    """sensor_msgs/CompressedImage."""

    header: Header
    format: str
    data: sequence[uint8]


ROS_NAMES: Mapping[type[IdlStruct], str] = {
    Bool: "std_msgs/msg/Bool",
    JointState: "sensor_msgs/msg/JointState",
    CompressedImage: "sensor_msgs/msg/CompressedImage",
}


class Ros2Bridge:
    """Publishes readings of sensors to ROS 2 nodes. Publishing never waits for a receiver.

    domain: ROS_DOMAIN_ID of the nodes. published: number of messages. The network interface is chosen by
    Cyclone DDS, or by its settings in the environment variable CYCLONEDDS_URI.
    """

    def __init__(self, domain: int, clock: Clock) -> None:
        self.published = 0
        self._participant = DomainParticipant(domain)
        self._clock = clock
        self._types = get_typestore(Stores.LATEST)
        self._writers: dict[str, DataWriter[IdlStruct]] = {}

    def publish(self, reading: Reading) -> None:
        """Publish a reading: image, angle and alarm, each on a topic with the sensor's name.

        The stamp is the capture time as a date. An unknown angle is NaN, as in the bags of `rig export`.
        """
        name = ros_name(reading.name)
        header = Header(self._stamp(reading.time_ns), f"{name}_optical_frame")
        if reading.frame is not None:
            image = CompressedImage(header, "jpeg", with_jpeg(reading.frame).jpeg)  # type: ignore[arg-type]
            self._write(f"{name}/image_raw/compressed", image)
        if (sample := reading.sample) is not None:
            values = [_radians(v) for v in (sample.angle_deg, sample.sigma_deg, sample.rate_deg_s)]
            names = ["angle", "angle_sigma", "angle_rate"]
            state = JointState(header, names, values, [], [])  # type: ignore[arg-type]
            self._write(f"angle/{name}", state)
            self._write(f"slip/{name}", Bool(bool(sample.slip)))

    @staticmethod
    def topics(sensors: Sequence[str]) -> list[str]:
        """Return the topics of sensors, and of their object if there are two, as ROS names them.

        Raises `InputError` if two of them would share their topics.
        """
        named = [*sensors, *([OBJECT] if len(sensors) > 1 else [])]
        for one, other in combinations(named, 2):
            if ros_name(one) == ros_name(other):
                raise InputError(
                    f"sources '{one}' and '{other}' would share the ROS 2 topics of '{ros_name(one)}' (only "
                    "letters, digits and underscores are allowed): rename the source, or give a serial"
                )
        names = [ros_name(sensor) for sensor in sensors]
        images = [f"/{name}/image_raw/compressed" for name in names]
        names += [OBJECT] if len(names) > 1 else []
        return [*images, *(f"/{kind}/{name}" for kind in ("angle", "slip") for name in names)]

    def _write(self, topic: str, message: IdlStruct) -> None:
        writer = self._writers.get(topic)
        if writer is None:
            kind = type(message)
            described = f"typehash={self._types.hash_rihs01(ROS_NAMES[kind])};".encode()
            # A reliable writer matches every reader. With a bounded history it does not wait for slow
            # readers.
            qos = Qos(
                Policy.Reliability.Reliable(duration(seconds=0)),
                Policy.History.KeepLast(DEPTH),
                Policy.Userdata(described),
            )
            writer = DataWriter(self._participant, Topic(self._participant, f"rt/{topic}", kind), qos=qos)
            self._writers[topic] = writer
        writer.write(message)
        self.published += 1

    def _stamp(self, time_ns: int) -> Time:
        """Return a time of the rig's monotonic clock as a date."""
        return Time(*divmod(time.time_ns() - self._clock.now_ns() + time_ns, NS_PER_S))


def ros_name(name: str) -> str:
    """Return a source's name as a ROS 2 name: letters, digits and underscores, no digit first."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "sensor"
    return f"sensor_{plain}" if plain[0].isdigit() else plain


def _radians(degrees: float | None) -> float:
    return math.nan if degrees is None else math.radians(degrees)
