"""Resample a lift at equal time steps, with the latest value of each source at each step."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from protocols.observer import Phase
from rig.export.csv_parquet import POSE, WRENCH
from rig.export.rotations import ContinuousPoses
from rig.sessions.reading import (
    phase_times,
    recorded_angle,
    recorded_gripper,
    recorded_joints,
    recorded_jpeg,
    recorded_pose,
)
from rig.sessions.recorder import (
    ARM_TOPIC,
    FUSED_TOPIC,
    GRIPPER_TOPIC,
    IMAGE_PREFIX,
    JOINTS_TOPIC,
    TRUTH_TOPIC,
    image_topic,
)
from rig.sessions.recording_file import recorded_messages

WRENCH_TRACK = "wrench"
UNKNOWN_SIGMA_DEG = 180.0
"""Sigma of an unknown angle. A number, because NaN would make the statistics of a data set NaN."""


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A lift from the grasp to the end of the hold, in N time steps of 1/rate.

    images: by serial, for each step the window of the newest stored JPEGs, newest first. A window that begins
    before the first frame repeats that frame. ages_s: by serial, (N, K) float32, time from the capture of
    each of these frames to the step. state: (N, K) float32, TCP position in m, quaternion xyzw, position of
    the gripper, and the wrench in the base's axes (N, N m) if recorded. names: of the components of the
    state. commanded: number of leading components of the state that are positions. angle: (N, 3)
    float32, the last estimate (deg, 0 before the first), its sigma (deg,
    `UNKNOWN_SIGMA_DEG` if unknown), and 1 if the newest message has an angle, else 0. truth_deg: (N,)
    float32, the last true angle (0 before the first). truth_known: (N,) bool, whether the newest message has
    a true angle.
    """

    images: dict[str, list[list[bytes]]]
    ages_s: dict[str, NDArray[np.float32]]
    state: NDArray[np.float32]
    names: tuple[str, ...]
    commanded: int
    angle: NDArray[np.float32]
    truth_deg: NDArray[np.float32]
    truth_known: NDArray[np.bool_]

    @property
    def steps(self) -> int:
        """Number of time steps."""
        return len(self.state)


@dataclass(slots=True)
class _Track:
    """Values of one source over time, with look-up of the latest."""

    time_ns: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, time_ns: int, value: Any) -> None:
        self.time_ns.append(time_ns)
        self.values.append(value)

    def at(self, time_ns: int) -> Any:
        """Return the latest value up to a time; None before the first."""
        window = self.window(time_ns, 1)
        return window[0][1] if window else None

    def window(self, time_ns: int, size: int) -> list[tuple[int, Any]]:
        """Return the `size` latest values up to a time, newest first, with their times.

        Before the first value of the track, that value is repeated.
        """
        end = bisect_right(self.time_ns, time_ns)
        places = [max(end - 1 - back, 0) for back in range(size)] if end else []
        return [(self.time_ns[place], self.values[place]) for place in places]


def read_episode(recording: Path, rate_hz: int, windows: Mapping[str, int]) -> Episode:
    """Read a recorded lift at `rate_hz` steps per second. Raises `SessionError` if it is damaged.

    windows: number of frames in the window of each serial; 1 for serials without entry.
    """
    phases = phase_times(recording)
    tracks: dict[str, _Track] = {}
    poses = ContinuousPoses()
    for topic, time_ns, _, data in recorded_messages(recording):
        for name, value in _values(topic, data, recording, poses):
            tracks.setdefault(name, _Track()).add(time_ns, value)
    serials = sorted(topic.removeprefix(IMAGE_PREFIX) for topic in tracks if topic.startswith(IMAGE_PREFIX))
    needed = [tracks.get(topic) for topic in (ARM_TOPIC, JOINTS_TOPIC, GRIPPER_TOPIC)]
    if None in needed or not serials:
        raise SessionError(f"{recording}: has no arm, gripper or image data; the session is damaged")
    seen = [track for topic, track in tracks.items() if topic not in (FUSED_TOPIC, TRUTH_TOPIC)]
    start = max(phases[Phase.GRASP], *(track.time_ns[0] for track in seen))
    count = (phases[Phase.LOWER] - start) * rate_hz // NS_PER_S
    if count < 1:
        raise SessionError(f"{recording}: has no data between grasp and end; the session is damaged")
    times = [start + step * NS_PER_S // rate_hz for step in range(count)]
    frames = {s: [tracks[image_topic(s)].window(t, windows.get(s, 1)) for t in times] for s in serials}
    gripper = tracks[GRIPPER_TOPIC].at(start)[0]
    wrenches = tracks.get(WRENCH_TRACK)
    state = [
        (*tracks[ARM_TOPIC].at(t), tracks[GRIPPER_TOPIC].at(t)[1], *(wrenches.at(t) if wrenches else ()))
        for t in times
    ]
    estimate, estimate_known = _angles(tracks.get(FUSED_TOPIC), times)
    truth, truth_known = _angles(tracks.get(TRUTH_TOPIC), times)
    return Episode(
        {serial: [[jpeg for _, jpeg in window] for window in seen] for serial, seen in frames.items()},
        {serial: _ages_s(seen, times) for serial, seen in frames.items()},
        np.array(state, np.float32),
        (*POSE, gripper, *(WRENCH if wrenches else ())),
        len(POSE) + 1,
        np.column_stack([estimate, _sigmas(tracks.get(FUSED_TOPIC), times), estimate_known]).astype(
            np.float32
        ),
        truth,
        truth_known,
    )


def _values(topic: str, data: bytes, path: Path, poses: ContinuousPoses) -> Iterator[tuple[str, Any]]:
    """Yield the values of a message with the names of their tracks."""
    if topic.startswith(IMAGE_PREFIX):
        yield topic, recorded_jpeg(data, path)
    elif topic == ARM_TOPIC:
        pose = poses.next(recorded_pose(data, path))
        yield topic, (*pose.position_m, *pose.quaternion_xyzw)
    elif topic == JOINTS_TOPIC:
        arm = recorded_joints(data, path)
        yield topic, arm.joints_rad
        if arm.wrench is not None:
            yield WRENCH_TRACK, arm.wrench
    elif topic == GRIPPER_TOPIC:
        kept = recorded_gripper(data, path)
        counts = kept.position_counts
        yield topic, ("gripper_opening_m", kept.opening_m) if counts is None else ("gripper_counts", counts)
    elif topic in (FUSED_TOPIC, TRUTH_TOPIC):
        angle = recorded_angle(data, path, 0)
        yield topic, (angle.angle_deg, angle.sigma_deg)


def _ages_s(windows: list[list[tuple[int, bytes]]], times: list[int]) -> NDArray[np.float32]:
    taken = np.array([[time_ns for time_ns, _ in window] for window in windows], np.int64)
    return ((np.array(times, np.int64)[:, None] - taken) / NS_PER_S).astype(np.float32)


def _angles(track: _Track | None, times: list[int]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the last known angle at each time, and whether the newest message has an angle."""
    latest = [(track.at(t) or (None,))[0] if track else None for t in times]
    held, last = np.zeros(len(times), np.float32), 0.0
    for step, angle in enumerate(latest):
        last = last if angle is None else angle
        held[step] = last
    return held, np.array([angle is not None for angle in latest], bool)


def _sigmas(track: _Track | None, times: list[int]) -> list[float]:
    """Return the sigma of the newest message at each time, deg."""
    found = [(track.at(t) or (None, None)) if track else (None, None) for t in times]
    return [UNKNOWN_SIGMA_DEG if angle is None or sigma is None else sigma for angle, sigma in found]
