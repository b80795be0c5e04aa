"""Export a trial as ROS 2 bags (MCAP storage), one per lift, with standard messages; ROS is not needed.

Stamps are those of the recording, converted to UTC; for an image, its capture time. The frames are `base`
(base frame of the arm's controller), `tool` (tool centre point), `camera_optical_frame` (x right, y down, z
forward), `table`, and `finger_b_optical_frame` for the fingertip on finger B. The pose of a fingertip on the
tool is not measured, so there is no transform to it.

Angles are JointState messages. Unlike those of Vector3Stamped, their values have names, here `angle` and
`angle_sigma`; unlike with a quaternion, an angle may exceed half a turn. They are in rad (REP 103), NaN if
refused or unknown, and counter-clockwise positive in the camera image, which is a rotation about -z of the
camera frame.
"""

import math
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from rosbags import interfaces
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.types import Pose, Vector6
from rig.config import BenchConfig
from rig.export.messages import lift_messages
from rig.export.result import CAMERA, Exported, ExportRequest, simulated_mark, source_name
from rig.sessions.about import RecordingAbout
from rig.sessions.manifest import TrialManifest, require_kind
from rig.sessions.reading import RecordedAngle, RecordedGripper, RecordedJoints, recorded_jpeg
from rig.tactile.angles import FUSED, MARKERS

BASE, TOOL = "base", "tool"
STATIC = "/tf_static"
ANGLES = {FUSED: "estimate", MARKERS: "markers"}
"""Names of the angles that do not belong to a fingertip."""
JOINTS = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
"""Joint names of a UR5e in ur_description."""
BAG_VERSION = 8
"""Version of the bag's metadata: the older of the two versions that rosbags can write."""
LAST_NS = 2**31 * NS_PER_S
"""First time that does not fit into a ROS stamp (int32 seconds), in 2038."""
_NEVER = interfaces.QosTime(0, 0)
LATCHED = interfaces.Qos(
    interfaces.QosHistory.KEEP_LAST, 1, interfaces.QosReliability.RELIABLE,
    interfaces.QosDurability.TRANSIENT_LOCAL, _NEVER, _NEVER, interfaces.QosLiveliness.SYSTEM_DEFAULT,
    _NEVER, False,
)  # fmt: skip
"""Quality of service of static transforms: nodes that start later receive them, too."""
Stamped = tuple[int, str, Any]
"""Time in ns, topic, message."""


def export_rosbag2(request: ExportRequest) -> Exported:
    """Write a bag per lift, in a folder with the name of the lift's recording.

    Raises `SessionError` for a session of rig record.
    """
    why = "a recording has images at rest, no lifts; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    mark, messages = simulated_mark(manifest), 0
    for lift in request.finished_lifts:
        recording = request.session / lift.recording
        about = {"session": request.session.name, "object": lift.object, "name": lift.name}
        about |= {
            "lift": str(lift.lift),
            "simulated": mark.strip() or "no",
            "tool_version": manifest.tool_version,
        }
        messages += _write(request.out / recording.stem, _messages(recording, manifest.config), about)
    note = f"{mark}ROS 2 bags (MCAP); angles in rad"
    return Exported({"bags": len(request.finished_lifts), "messages": messages}, (note,))


def _write(folder: Path, messages: Iterator[Stamped], about: dict[str, str]) -> int:
    """Write a bag with its messages in order of time; return their number."""
    types, connections = get_typestore(Stores.ROS2_HUMBLE), dict[str, interfaces.Connection]()
    with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as bag:
        for key, value in about.items():
            bag.set_custom_data(key, value)
        for time_ns, topic, message in sorted(messages, key=itemgetter(0)):
            kind = message.__msgtype__
            if topic not in connections:
                quality = [LATCHED] if topic == STATIC else []
                connections[topic] = bag.add_connection(
                    topic, kind, typestore=types, offered_qos_profiles=quality
                )
            bag.write(connections[topic], time_ns, types.serialize_cdr(message, kind))
        return sum(bag.counts.values())


def _messages(recording: Path, bench: BenchConfig) -> Iterator[Stamped]:
    """Yield the messages of a recorded lift. Raises `SessionError` if it is damaged."""
    pose = Pose((0.0, 0.0, 0.0))
    calibration = RecordingAbout(camera=bench.camera_model()).calibration(0)
    static = {_optical(CAMERA): bench.base_T_camera(), "table": Pose(bench.require("table").position_m)}
    for message in lift_messages(recording, dated=True):
        time_ns, value = message.time_ns, message.value
        if time_ns >= LAST_NS:
            raise SessionError(f"{recording}: has a time after 2038, too late for ROS stamps; use --to csv")
        if static:
            yield time_ns, STATIC, _transforms(time_ns, static)
            static = {}
        if isinstance(value, bytes):
            name = source_name(message.source, bench)
            header, jpeg = _header(time_ns, _optical(name)), recorded_jpeg(value, recording)
            image = ros.sensor_msgs__msg__CompressedImage(header, "jpeg", np.frombuffer(jpeg, np.uint8))
            yield time_ns, f"/{name}/image_raw/compressed", image
            if name == CAMERA and calibration is not None:
                yield time_ns, f"/{name}/camera_info", _camera_info(header, calibration)
        elif isinstance(value, Pose):
            pose = value
            yield time_ns, "/tf", _transforms(time_ns, {TOOL: pose})
        elif isinstance(value, RecordedJoints):
            joints = dict(zip(JOINTS, value.joints_rad, strict=True))
            yield time_ns, "/joint_states", _values(time_ns, BASE, joints)
            if value.wrench is not None:
                yield time_ns, "/wrench", _wrench(time_ns, pose, value.wrench)
        elif isinstance(value, RecordedGripper):
            fingers = {"gripper_opening": value.opening_m}
            if value.position_counts is not None:
                fingers["gripper_counts"] = float(value.position_counts)
            yield time_ns, "/gripper/joint_states", _values(time_ns, TOOL, fingers)
        elif isinstance(value, RecordedAngle):
            name = ANGLES.get(message.source) or source_name(message.source, bench)
            angle = {"angle": _radians(value.angle_deg), "angle_sigma": _radians(value.sigma_deg)}
            yield time_ns, f"/angle/{name}", _values(time_ns, _optical(CAMERA), angle)


def _optical(source: str) -> str:
    """Return the name of the frame of a source's images: x right, y down, z forward (REP 103)."""
    return f"{source}_optical_frame"


def _radians(degrees: float | None) -> float:
    return math.nan if degrees is None else math.radians(degrees)


def _header(time_ns: int, frame: str) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(time_ns, NS_PER_S)), frame)


def _values(time_ns: int, frame: str, values: Mapping[str, float]) -> ros.sensor_msgs__msg__JointState:
    unknown = np.zeros(0)
    return ros.sensor_msgs__msg__JointState(
        _header(time_ns, frame), list(values), np.array(list(values.values()), float), unknown, unknown
    )


def _transforms(time_ns: int, poses: Mapping[str, Pose]) -> ros.tf2_msgs__msg__TFMessage:
    """Return the message of transforms. poses: `base_T_child` by the name of the child."""
    stamped = []
    for child, pose in poses.items():
        place = ros.geometry_msgs__msg__Vector3(*pose.position_m)
        turn = ros.geometry_msgs__msg__Quaternion(*pose.quaternion_xyzw)
        transform = ros.geometry_msgs__msg__Transform(place, turn)
        stamped.append(ros.geometry_msgs__msg__TransformStamped(_header(time_ns, BASE), child, transform))
    return ros.tf2_msgs__msg__TFMessage(stamped)


def _wrench(time_ns: int, tool: Pose, wrench: Vector6) -> ros.geometry_msgs__msg__WrenchStamped:
    """Return the message of a wrench. wrench: at the TCP in the base's axes; ROS expects the tool's axes."""
    force, torque = tool.rotation.inv().apply(np.reshape(wrench, (2, 3)))
    vectors = (ros.geometry_msgs__msg__Vector3(*map(float, vector)) for vector in (force, torque))
    return ros.geometry_msgs__msg__WrenchStamped(
        _header(time_ns, TOOL), ros.geometry_msgs__msg__Wrench(*vectors)
    )


def _camera_info(
    header: ros.std_msgs__msg__Header, camera: CameraCalibration
) -> ros.sensor_msgs__msg__CameraInfo:
    d, k, r, p = (np.array(values, float) for values in (camera.D, camera.K, camera.R, camera.P))
    whole = ros.sensor_msgs__msg__RegionOfInterest(0, 0, 0, 0, False)
    return ros.sensor_msgs__msg__CameraInfo(
        header, camera.height, camera.width, camera.distortion_model, d, k, r, p, 0, 0, whole
    )
