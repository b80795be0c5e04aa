"""Export a trial as a LeRobotDataset, format 3.0: an episode per lift, a file per episode.

A row is a time step at the rate of the camera. The format has one image per row and feature. If fingertips
are faster than the camera, their earlier frames since the last step are further features of type "image".

Format: huggingface/lerobot, `datasets/lerobot_dataset.py` and `datasets/utils.py` of version 0.4. The stored
JPEGs are copied into the Parquet files (feature type "image"), because a video codec would change the small
differences in brightness that the estimators use.
"""

import json
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.images import decode_stored
from drivers.types import Image
from protocols.observer import Phase
from rig.export.csv_parquet import POSE, WRENCH
from rig.export.result import Exported, ExportRequest, simulated_mark, source_name
from rig.export.rotations import ContinuousPoses
from rig.sessions.manifest import TrialManifest, require_kind
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
from rig.sessions.records import Lift
from rig.sessions.table_files import Line, pyarrow_modules

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
        angle = recorded_angle(data, path)
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


Floats = NDArray[np.float64]
FORMAT_VERSION = "v3.0"
FILES_PER_CHUNK = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
CARD = """# {session}

{mark}slip trial with an episode per lift, from the grasp to the end of the hold.

- `observation.state`: pose of the TCP in the base frame (m, quaternion xyzw); the gripper's counts, or its
  opening in m if it has no counts; force (N) and torque (N m) at the TCP in the base's axes, if measured.
- `action`: pose and gripper one step later. Commands are not recorded; the action is the state reached.
- `observation.angle`: rotation of the object since the grasp, estimated from the fingertips: `angle_deg`,
  degrees, counter-clockwise positive in the camera image; `sigma_deg`, its standard deviation; `known`, 1 or
  0. If `known` is 0, there is no estimate at that step: `angle_deg` is the last one, and `sigma_deg` is 180.
- `angle.truth_deg`: the same rotation, measured from the object's markers; a label, not an observation. If
  `angle.truth_known` is false, the markers were not detected at that step, and this is the last value.
- `observation.images.*`: the newest stored JPEG at each step ({fps} steps per second), by source: {sources}.
- `observation.tactile.NAME.1`, `.2`, ...: earlier frames of fingertip NAME since the last step, if fingertips
  are faster than {fps} frames per second; `observation.tactile.NAME.age_s`: time from each frame to the step
  in s, newest first.
"""


@dataclass(slots=True)
class _Sums:
    low: Floats
    high: Floats
    total: Floats
    squares: Floats
    rows: int
    count: int
    shape: tuple[int, ...]


@dataclass(slots=True)
class FeatureStatistics:
    """Minimum, maximum, mean and standard deviation of each feature, accumulated over episodes.

    Statistics of vectors are per component, those of images per channel, scaled to 0..1. They are accumulated
    because the images of a session do not fit into memory. LeRobot's own code for this needs torch.
    """

    _sums: dict[str, _Sums] = field(default_factory=dict)

    def add(self, name: str, values: Floats) -> None:
        """Add (N, K) values."""
        self._add(name, values, len(values), (values.shape[1],))

    def add_image(self, name: str, image: Image) -> None:
        """Add an (H, W, 3) uint8 image."""
        self._add(name, image.reshape(-1, 3) / 255.0, 1, (3, 1, 1))

    def as_json(self) -> dict[str, dict[str, Sequence[object]]]:
        """Return `min`, `max`, `mean`, `std` and `count` of each feature, in LeRobot's format."""
        return {name: _as_json(sums) for name, sums in self._sums.items()}

    def _add(self, name: str, values: Floats, count: int, shape: tuple[int, ...]) -> None:
        low, high, total, squares = values.min(0), values.max(0), values.sum(0), (values**2).sum(0)
        known = self._sums.get(name)
        if known is None:
            self._sums[name] = _Sums(low, high, total, squares, len(values), count, shape)
            return
        known.low, known.high = np.minimum(known.low, low), np.maximum(known.high, high)
        known.total, known.squares = known.total + total, known.squares + squares
        known.rows, known.count = known.rows + len(values), known.count + count


def _as_json(sums: _Sums) -> dict[str, Sequence[object]]:
    mean = sums.total / sums.rows
    spread = np.sqrt(np.maximum(sums.squares / sums.rows - mean**2, 0.0))
    figures = {"min": sums.low, "max": sums.high, "mean": mean, "std": spread}
    return {**{key: v.reshape(sums.shape).tolist() for key, v in figures.items()}, "count": [sums.count]}


@dataclass(frozen=True, slots=True)
class Feature:
    """A column of the data set. names: names of the components; None for a single number."""

    dtype: str
    shape: list[int]
    names: list[str] | None


def write_meta(
    request: ExportRequest,
    fps: int,
    features: Mapping[str, Feature],
    tasks: list[str],
    episodes: list[Line],
    frames: int,
    statistics: FeatureStatistics,
) -> None:
    """Write `meta/` and the card.

    features: as in `info.json`. episodes: rows of `meta/episodes`. frames: number of steps of all episodes.
    """
    arrow, parquet = pyarrow_modules()
    out = request.out
    info = {
        "codebase_version": FORMAT_VERSION,
        "robot_type": "ur5e_robotiq_3f_digit",
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": len(tasks),
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": {name: asdict(feature) for name, feature in features.items()},
    }
    (out / EPISODES_PATH).parent.mkdir(parents=True)
    (out / "meta/info.json").write_text(json.dumps(info, indent=4))
    (out / "meta/stats.json").write_text(json.dumps(statistics.as_json(), indent=4))
    parquet.write_table(arrow.Table.from_pylist(episodes), out / EPISODES_PATH)
    parquet.write_table(_tasks_table(tasks), out / "meta/tasks.parquet")
    mark = simulated_mark(request.manifest)
    sources = _sources(request)
    (out / "README.md").write_text(
        CARD.format(session=request.session.name, mark=mark, fps=fps, sources=sources)
    )


def _sources(request: ExportRequest) -> str:
    """Return a text with the sensor of each image feature."""
    bench = getattr(request.manifest, "config", None)
    if bench is None:
        return "see the session"
    tips = [f"`finger_{t.finger.lower()}` {t.serial} (sign {t.sign:+d})" for t in bench.tactile]
    return ", ".join([*tips, f"`camera` {bench.camera.serial}"])


def _tasks_table(tasks: list[str]) -> Any:
    """Return the table of tasks with their text as the pandas index, which the loader needs."""
    arrow, _ = pyarrow_modules()
    index = "__index_level_0__"
    table = arrow.table({"task_index": list(range(len(tasks))), index: tasks})
    described = [
        {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, field, kind, numpy in (
            ("task_index", "task_index", "int64", "int64"),
            (None, index, "unicode", "object"),
        )
    ]
    pandas = {"index_columns": [index], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


ANGLE_NAMES = ["angle_deg", "sigma_deg", "known"]
SCALARS = {"angle.truth_deg": "float32", "angle.truth_known": "bool"}
COUNTERS = {
    "timestamp": "float32",
    **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
}
EVERY_IMAGE = 30
"""Every Nth image is included in the statistics."""


class StoredJpeg(TypedDict):
    """An entry of an image column: the stored JPEG and a file name."""

    bytes: bytes
    path: str


def export_lerobot(request: ExportRequest) -> Exported:
    """Write the data set. Raises `SessionError` for a session of rig record, `InputError` without pyarrow."""
    why = "a recording has images at rest, no episodes; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    pyarrow_modules()
    fps, lifts = round(manifest.config.camera.rate_hz), request.finished_lifts
    tasks = sorted({_task(lift) for lift in lifts})
    windows = {tip.serial: math.ceil(tip.rate_hz / fps) for tip in manifest.config.tactile}
    statistics = FeatureStatistics()
    episodes: list[Line] = []
    features: dict[str, Feature] = {}
    first = 0
    for number, lift in enumerate(lifts):
        episode = read_episode(request.session / lift.recording, fps, windows)
        names = {serial: source_name(serial, manifest.config) for serial in episode.images}
        features = features or _features(episode, names)
        columns = _columns(episode, names, number, first, tasks.index(_task(lift)), fps)
        pictures = _pictures(episode, names, number)
        _write_data(request.out, number, {**pictures, **columns}, features)
        _count(statistics, pictures, columns)
        episodes.append(_episode_line(number, first, episode.steps, _task(lift)))
        first += episode.steps
    write_meta(request, fps, features, tasks, episodes, first, statistics)
    note = f"{simulated_mark(request.manifest)}LeRobotDataset {FORMAT_VERSION}, {fps} steps a second"
    return Exported({"episodes": len(episodes), "frames": first, "tasks": len(tasks)}, (note,))


def _task(lift: Lift) -> str:
    return f"lift the {lift.name} and feel it turn"


def image_key(name: str, back: int) -> str:
    """Return the name of the feature for a source's images. back: number of frames before the newest."""
    return f"observation.tactile.{name}.{back}" if back else f"observation.images.{name}"


def _features(episode: Episode, names: Mapping[str, str]) -> dict[str, Feature]:
    """Return the features for `meta/info.json`. names: names of the sources by serial."""
    features: dict[str, Feature] = {}
    for serial, windows in episode.images.items():
        height, width = decode_stored(windows[0][0]).shape[:2]
        for back in range(len(windows[0])):
            key = image_key(names[serial], back)
            features[key] = Feature("image", [height, width, 3], ["height", "width", "channels"])
    for key, ages in _ages(episode, names).items():
        features[key] = Feature(
            "float32", [ages.shape[1]], [f"frame_{back}" for back in range(ages.shape[1])]
        )
    state, commanded = list(episode.names), list(episode.names[: episode.commanded])
    features["observation.state"] = Feature("float32", [len(state)], state)
    features["action"] = Feature("float32", [len(commanded)], commanded)
    features["observation.angle"] = Feature("float32", [len(ANGLE_NAMES)], ANGLE_NAMES)
    return features | {name: Feature(dtype, [1], None) for name, dtype in {**SCALARS, **COUNTERS}.items()}


def _ages(episode: Episode, names: Mapping[str, str]) -> dict[str, NDArray[np.float32]]:
    """Return the ages of the frames in s, for each source with more than one frame per step."""
    windows = {f"observation.tactile.{names[s]}.age_s": ages for s, ages in episode.ages_s.items()}
    return {key: ages for key, ages in windows.items() if ages.shape[1] > 1}


def _pictures(episode: Episode, names: Mapping[str, str], number: int) -> dict[str, list[StoredJpeg]]:
    """Return the stored images by feature, one per step."""
    return {
        image_key(names[serial], back): [
            {"bytes": window[back], "path": f"{serial}-{number:03d}-{step:06d}-{back}.jpg"}
            for step, window in enumerate(windows)
        ]
        for serial, windows in episode.images.items()
        for back in range(len(windows[0]))
    }


def _columns(
    episode: Episode, names: Mapping[str, str], number: int, first: int, task: int, fps: int
) -> dict[str, NDArray[Any]]:
    """Return the numeric columns of an episode, with one row per step."""
    steps = np.arange(episode.steps)
    commanded = episode.state[:, : episode.commanded]
    return {
        **_ages(episode, names),
        "observation.state": episode.state,
        "action": np.concatenate([commanded[1:], commanded[-1:]]),
        "observation.angle": episode.angle,
        "angle.truth_deg": episode.truth_deg,
        "angle.truth_known": episode.truth_known,
        "timestamp": (steps / fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(episode.steps, number),
        "index": first + steps,
        "task_index": np.full(episode.steps, task),
    }


def _write_data(
    out: Path,
    number: int,
    columns: Mapping[str, NDArray[Any] | list[StoredJpeg]],
    features: Mapping[str, Feature],
) -> None:
    arrow, parquet = pyarrow_modules()
    chunk, file = divmod(number, FILES_PER_CHUNK)
    path = out / DATA_PATH.format(chunk_index=chunk, file_index=file)
    path.parent.mkdir(parents=True, exist_ok=True)
    kinds = {
        "image": arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())]),
        "bool": arrow.bool_(),
    }

    def column(name: str) -> Any:
        feature = features[name]
        if feature.dtype in kinds:
            return arrow.array(list(columns[name]), kinds[feature.dtype])
        kind = {"float32": arrow.float32(), "int64": arrow.int64()}[feature.dtype]
        if feature.shape == [1]:
            return arrow.array(columns[name], kind)
        return arrow.array(np.asarray(columns[name]).tolist(), arrow.list_(kind, feature.shape[0]))

    # JPEGs cannot be compressed further; without compression the loader can memory-map them.
    table = arrow.Table.from_arrays([column(name) for name in features], names=list(features))
    parquet.write_table(table, path, compression="none", use_dictionary=False, row_group_size=100)


def _count(
    statistics: FeatureStatistics,
    pictures: Mapping[str, list[StoredJpeg]],
    columns: Mapping[str, NDArray[Any]],
) -> None:
    for name, shown in pictures.items():
        for picture in shown[::EVERY_IMAGE]:
            statistics.add_image(name, decode_stored(picture["bytes"]))
    for name, values in columns.items():
        statistics.add(name, np.asarray(values, np.float64).reshape(len(values), -1))


def _episode_line(number: int, first: int, steps: int, task: str) -> Line:
    chunk, file = divmod(number, FILES_PER_CHUNK)
    return {
        "episode_index": number,
        "tasks": [task],
        "length": steps,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": first,
        "dataset_to_index": first + steps,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
