"""Export a trial to one file for the rerun viewer, with the entities and layout of the live view."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.export.rotations import ContinuousPoses
from rig.live.feed import Message
from rig.live.rerun import RerunScene
from rig.sessions.manifest import TrialManifest, require_kind
from rig.sessions.reading import phase_times, recorded_angle, recorded_jpeg, recorded_pose
from rig.sessions.recorder import ARM_TOPIC, FUSED_TOPIC, IMAGE_PREFIX, TRUTH_TOPIC
from rig.sessions.recording_file import recorded_messages

FILE = "lifts.rrd"


def export_rerun(request: ExportRequest) -> Exported:
    """Write the lifts one after the other. Raises `SessionError` for a session of rig record."""
    why = "a recording has images at rest, no lifts; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    scene, messages, camera = RerunScene(request.out / FILE), 0, manifest.config.camera.serial
    for lift in request.finished_lifts:
        values = {"sender": 0, "number": lift.number, "attempt": 0, "name": lift.name}
        values["simulated"] = manifest.simulated
        for message in _messages(request.session / lift.recording, camera):
            scene.show(Message(message.kind, {**values, **message.values}, message.picture))
            messages += 1
    scene.close()
    note = f"{simulated_mark(manifest)}rerun {FILE}"
    return Exported({"lifts": len(request.finished_lifts), "messages": messages}, (note,))


def _messages(recording: Path, camera: str) -> Iterator[Message]:
    """Yield a recorded lift as messages of the live view. Raises `SessionError` if it is damaged."""
    poses = ContinuousPoses()
    for phase, time_ns in phase_times(recording).items():
        yield Message("phase", {"phase": phase, "time_ns": time_ns})
    for topic, time_ns, _, data in recorded_messages(recording):
        values: dict[str, Any] = {"time_ns": time_ns}
        if topic.startswith(IMAGE_PREFIX):
            values["serial"] = topic.removeprefix(IMAGE_PREFIX)
            if values["serial"] == camera:
                values |= {"source": "camera", "markers_px": None}
            yield Message("frame", values, recorded_jpeg(data, recording))
        elif topic == ARM_TOPIC:
            pose = poses.next(recorded_pose(data, recording))
            values |= {"position_m": pose.position_m, "quaternion_xyzw": pose.quaternion_xyzw}
            yield Message("arm", values)
        elif topic in (FUSED_TOPIC, TRUTH_TOPIC):
            angle = recorded_angle(data, recording, time_ns)
            points: dict[str, Any] = {"estimate": [], "truth": []}
            if topic == FUSED_TOPIC:
                points["estimate"] = [(time_ns, angle.angle_deg, angle.sigma_deg)]
            else:
                points["truth"] = [(time_ns, angle.angle_deg)]
            yield Message("figures", values | points)
