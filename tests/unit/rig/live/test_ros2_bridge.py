"""Live angles as ROS 2 topics: the bytes of messages, names, and receivers in other processes."""

import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from drivers.clock import SystemClock
from drivers.errors import InputError
from rig.live import ros2_bridge as ros2
from rig.live.ros2_bridge import Ros2Bridge, ros_name

TYPES = get_typestore(Stores.ROS2_HUMBLE)
JPEG = bytes(range(256)) * 100
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/>"
    "</Interfaces></General></Domain></CycloneDDS>"
)
PEER = Path(__file__).parents[3] / "support/fast_dds_peer.cpp"
RECEIVER = """
import sys, time
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from rig.live.ros2_bridge import JointState
participant = DomainParticipant(int(sys.argv[1]))
topic = Topic(participant, "rt/angle/D20641", JointState)
reader = DataReader(participant, topic, qos=Qos(Policy.Reliability.BestEffort))
end = time.monotonic() + 20
while time.monotonic() < end:
    for message in reader.take(100):
        print(*message.name, *message.position, message.header.frame_id, flush=True)
        sys.exit()
    time.sleep(0.01)
"""


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A domain of this test alone, on loopback."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return 100 + os.getpid() % 100


def reading(angle_deg: float | None = 30.0, slip: bool = False) -> Any:
    sample = SimpleNamespace(angle_deg=angle_deg, sigma_deg=0.5, rate_deg_s=None, slip=slip)
    return SimpleNamespace(
        name="D20641", time_ns=SystemClock().now_ns(), frame=SimpleNamespace(jpeg=JPEG), sample=sample
    )


def test_messages_have_the_bytes_that_rosbags_writes() -> None:
    header = ros2.Header(ros2.Time(12, 34), "D20641_optical_frame")
    ros_header = TYPES.types["std_msgs/msg/Header"](
        TYPES.types["builtin_interfaces/msg/Time"](12, 34), "D20641_optical_frame"
    )
    none = np.zeros(0)
    of = TYPES.types
    for message, expected in (
        (ros2.Bool(True), of["std_msgs/msg/Bool"](True)),
        (
            ros2.JointState(header, ["angle", "angle_sigma"], [0.5, math.nan], [], []),
            of["sensor_msgs/msg/JointState"](
                ros_header, ["angle", "angle_sigma"], np.array([0.5, math.nan]), none, none
            ),
        ),
        (
            ros2.CompressedImage(header, "jpeg", JPEG),  # type: ignore[arg-type]
            of["sensor_msgs/msg/CompressedImage"](ros_header, "jpeg", np.frombuffer(JPEG, np.uint8)),
        ),
    ):
        name = ros2.ROS_NAMES[type(message)]
        received = TYPES.deserialize_cdr(message.serialize(), name)
        assert repr(received) == repr(expected)


def test_names_of_sources_become_names_of_ros_and_must_differ_as_such() -> None:
    for name, expected in (
        ("D20641", "D20641"), ("/dev/video2", "dev_video2"), ("0", "sensor_0"), ("%", "sensor"),
        ("http://127.0.0.1:80/a b", "http_127_0_0_1_80_a_b"),
    ):  # fmt: skip
        assert ros_name(name) == expected
    for one, other, topic in (
        ("left-1", "left_1", "left_1"), ("/dev/video2", "dev_video2", "dev_video2"),
        ("0", "sensor_0", "sensor_0"), ("links?", "links!", "links"), ("\u5de6", "\u53f3", "sensor"),
        ("D20641", "object", "object"), ("D20641", "-object-", "object"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"would share the ROS 2 topics of '{topic}'") as refused:
            Ros2Bridge.topics([one, other])
        assert f"'{other}'" in str(refused.value)
    for sensors in (["object"], ["left-1", "left_2"], ["a", "A"]):
        topics = Ros2Bridge.topics(sensors)
        assert len(set(topics)) == len(topics)


@pytest.mark.heavy
def test_another_process_receives_the_angle_in_radians(domain: int) -> None:
    bridge = Ros2Bridge(domain, SystemClock())
    command = [sys.executable, "-c", RECEIVER, str(domain)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as receiver:
        while receiver.poll() is None:
            bridge.publish(reading())
            time.sleep(0.02)
        assert receiver.stdout is not None
        words = receiver.stdout.read().split()
    assert words[:3] == ["angle", "angle_sigma", "angle_rate"]
    assert [float(word) for word in words[3:6]] == pytest.approx(
        [math.radians(30.0), math.radians(0.5), math.nan], nan_ok=True
    )
    assert words[6] == "D20641_optical_frame"
    assert bridge.published % 3 == 0
    assert bridge.topics(["D20641"]) == ["/D20641/image_raw/compressed", "/angle/D20641", "/slip/D20641"]
    assert bridge.topics(["a", "b"])[2:4] == ["/angle/a", "/angle/b"]
    assert "/slip/object" in bridge.topics(["a", "b"])


@pytest.fixture(scope="module")
def fast_dds_peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A receiver that is built on Fast DDS, the default middleware of ROS 2."""
    prefix, compiler = os.environ.get("FAST_DDS_PREFIX"), shutil.which("g++")
    if prefix is None or compiler is None:
        pytest.skip("no Fast DDS here: install it, set FAST_DDS_PREFIX, and have g++, to run this test")
    out = tmp_path_factory.mktemp("peer") / "fast_dds_peer"
    flags = ["-std=c++14", f"-I{prefix}/include", f"-L{prefix}/lib"]
    subprocess.run([compiler, *flags, PEER, "-lfastdds", "-lfastcdr", "-o", out], check=True)
    return out


def test_receiver_on_fast_dds_gets_images_angle_and_alarm(domain: int, fast_dds_peer: Path) -> None:
    topics = {
        "rt/D20641/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
        "rt/angle/D20641": "sensor_msgs/msg/JointState",
        "rt/slip/D20641": "std_msgs/msg/Bool",
    }
    pairs = [word for topic, kind in topics.items() for word in (topic, dds_name(kind))]
    bridge = Ros2Bridge(domain, SystemClock())
    libraries = f"{os.environ['FAST_DDS_PREFIX']}/lib"
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "LD_LIBRARY_PATH": libraries}
    command = [fast_dds_peer, "6", *pairs]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as receiver:
        end = time.monotonic() + 6.0
        while time.monotonic() < end:
            bridge.publish(reading(slip=True))
            time.sleep(0.05)
        assert receiver.stdout is not None
        lines = [line.split() for line in receiver.stdout.read().splitlines()]
    received = {topic: TYPES.deserialize_cdr(bytes.fromhex(data), topics[topic]) for topic, data in lines}
    assert set(received) == set(topics)
    image, angle, alarm = (received[topic] for topic in topics)
    assert bytes(image.data) == JPEG
    stamps = [
        {
            repr(TYPES.deserialize_cdr(bytes.fromhex(data), topics[topic]).header.stamp)
            for topic, data in lines
            if topic == name
        }
        for name in list(topics)[:2]
    ]
    assert stamps[0] & stamps[1]  # an image and its angle have the same stamp
    assert abs(angle.header.stamp.sec - time.time()) < 60
    assert angle.position[0] == pytest.approx(math.radians(30.0))
    assert alarm.data


def dds_name(kind: str) -> str:
    """Return how a type of ROS is named in DDS."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"
