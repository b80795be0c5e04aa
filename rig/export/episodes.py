"""A lift in equal time steps: the latest value of each source at each step."""

from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from protocols.observer import Phase
from rig.sessions.reading import (
    phase_times,
    recorded_angle,
    recorded_gripper,
    recorded_jpeg,
    recorded_pose,
)
from rig.sessions.recorder import (
    ARM_TOPIC,
    FUSED_TOPIC,
    GRIPPER_TOPIC,
    IMAGE_PREFIX,
    TRUTH_TOPIC,
    image_topic,
)
from rig.sessions.recording_file import recorded_messages


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A lift from the grasp until it is set down, N steps of 1/rate.

    images: by serial, N stored JPEGs. state: (N, 8) float32, TCP position in m, quaternion xyzw,
    position of the gripper, which `gripper` names with its unit. estimate_deg, truth_deg: (N,) float32, the
    last answer (0 before the first); estimate_known, truth_known: (N,) bool, whether there was one at that
    step.
    """

    images: dict[str, list[bytes]]
    state: NDArray[np.float32]
    gripper: str
    estimate_deg: NDArray[np.float32]
    estimate_known: NDArray[np.bool_]
    truth_deg: NDArray[np.float32]
    truth_known: NDArray[np.bool_]

    @property
    def steps(self) -> int:
        """Number of time steps."""
        return len(self.state)


@dataclass(slots=True)
class _Track:
    """Values of one source over time, for looking up the latest."""

    time_ns: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, time_ns: int, value: Any) -> None:
        self.time_ns.append(time_ns)
        self.values.append(value)

    def at(self, time_ns: int) -> Any:
        """Return the latest value up to a time, None before the first."""
        place = bisect_right(self.time_ns, time_ns)
        return self.values[place - 1] if place else None


def read_episode(recording: Path, rate_hz: int) -> Episode:
    """Read a recorded lift at `rate_hz` steps a second. Raises `SessionError` when it is damaged."""
    phases = phase_times(recording)
    tracks: dict[str, _Track] = {}
    for topic, time_ns, _, data in recorded_messages(recording):
        value = _value(topic, data, recording)
        if value is not None:
            tracks.setdefault(topic, _Track()).add(time_ns, value)
    serials = [topic.removeprefix(IMAGE_PREFIX) for topic in tracks if topic.startswith(IMAGE_PREFIX)]
    needed = [tracks.get(topic) for topic in (ARM_TOPIC, GRIPPER_TOPIC)]
    if None in needed or not serials:
        raise SessionError(f"{recording}: holds no arm, gripper or image; the session is damaged")
    seen = [track for topic, track in tracks.items() if topic not in (FUSED_TOPIC, TRUTH_TOPIC)]
    start = max(phases[Phase.GRASP], *(track.time_ns[0] for track in seen))
    count = (phases[Phase.LOWER] - start) * rate_hz // NS_PER_S
    if count < 1:
        raise SessionError(f"{recording}: holds no step from its grasp to its end; the session is damaged")
    times = [start + step * NS_PER_S // rate_hz for step in range(count)]
    estimate, estimate_known = _angles(tracks.get(FUSED_TOPIC), times)
    truth, truth_known = _angles(tracks.get(TRUTH_TOPIC), times)
    state = [(*tracks[ARM_TOPIC].at(t), tracks[GRIPPER_TOPIC].at(t)[1]) for t in times]
    return Episode(
        {serial: [tracks[image_topic(serial)].at(t) for t in times] for serial in sorted(serials)},
        np.array(state, np.float32),
        tracks[GRIPPER_TOPIC].at(start)[0],
        estimate,
        estimate_known,
        truth,
        truth_known,
    )


def _value(topic: str, data: bytes, path: Path) -> Any:
    if topic.startswith(IMAGE_PREFIX):
        return recorded_jpeg(data, path)
    if topic == ARM_TOPIC:
        pose = recorded_pose(data, path)
        return (*pose.position_m, *pose.quaternion_xyzw)
    if topic == GRIPPER_TOPIC:
        kept = recorded_gripper(data, path)
        if kept.position_counts is None:
            return "gripper_opening_m", kept.opening_m
        return "gripper_counts", kept.position_counts
    if topic in (FUSED_TOPIC, TRUTH_TOPIC):
        return (recorded_angle(data, path, 0).angle_deg,)
    return None


def _angles(track: _Track | None, times: list[int]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the last angle known at each time, and whether the newest message had one."""
    latest = [(track.at(t) or (None,))[0] if track else None for t in times]
    held, last = np.zeros(len(times), np.float32), 0.0
    for step, angle in enumerate(latest):
        last = last if angle is None else angle
        held[step] = last
    return held, np.array([angle is not None for angle in latest], bool)
