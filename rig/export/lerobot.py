"""Export a trial as a LeRobotDataset, format 3.0: an episode per lift, a file per episode.

A row is a time step at the rate of the camera. The format has one image per row and feature. If fingertips
are faster than the camera, their earlier frames since the last step are further features of type "image".

Format: huggingface/lerobot, `datasets/lerobot_dataset.py` and `datasets/utils.py` of version 0.4. The stored
JPEGs are copied into the Parquet files (feature type "image"), because a video codec would change the small
differences in brightness that the estimators use.
"""

import json
import math
import operator
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.images import decode_stored
from drivers.types import Pose
from protocols.observer import Phase
from rig.export.csv_parquet import POSE, WRENCH
from rig.export.messages import LiftMessage, lift_messages
from rig.export.result import Exported, ExportRequest, simulated_mark, source_name
from rig.sessions.manifest import TrialManifest, require_kind
from rig.sessions.reading import RecordedAngle, RecordedGripper, RecordedJoints, phase_times, recorded_jpeg
from rig.sessions.records import Lift
from rig.sessions.table_files import Line, pyarrow_modules
from rig.tactile.angles import FUSED, MARKERS

Numbers = NDArray[np.float32]
UNKNOWN_SIGMA_DEG = 180.0
"""Sigma of an unknown angle. A number, because NaN would make the statistics of a data set NaN."""
FORMAT_VERSION = "v3.0"
FILES_PER_CHUNK = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
ANGLE_NAMES = ["angle_deg", "sigma_deg", "known"]
EVERY_IMAGE = 30
"""Every Nth image is included in the statistics."""
CARD = """# {session}

{mark}slip trial with an episode per lift, from the grasp to the end of the hold; recorded with rig {version}.

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


class StoredJpeg(TypedDict):
    """An entry of an image column: the stored JPEG and a file name."""

    bytes: bytes
    path: str


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A lift from the grasp to the end of the hold, in N time steps of 1/rate.

    images: by serial, for each step the window of the newest stored JPEGs, newest first. A window that begins
    before the first frame repeats that frame. ages_s: by serial, (N, K) float32, time from the capture of
    each of these frames to the step. state: (N, K) float32, TCP position in m, quaternion xyzw, position of
    the gripper, and the wrench in the base's axes (N, N m) if recorded. names: of the components of the
    state. commanded: number of leading components of the state that are positions. angle, truth: (N, 3)
    float32, the last estimate or true angle (deg, 0 before the first), its sigma (deg, `UNKNOWN_SIGMA_DEG` if
    unknown), and 1 if the newest message has an angle, else 0.
    """

    images: dict[str, list[list[bytes]]]
    ages_s: dict[str, Numbers]
    state: Numbers
    names: tuple[str, ...]
    commanded: int
    angle: Numbers
    truth: Numbers

    @property
    def steps(self) -> int:
        return len(self.state)


@dataclass(slots=True)
class _Track:
    """Values of one source over time, with look-up of the latest."""

    time_ns: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

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


_IMAGES = "images/"
"""Begins the names of tracks of images, because a serial may be the name of another track."""


def read_episode(recording: Path, rate_hz: int, windows: Mapping[str, int]) -> Episode:
    """Read a recorded lift at `rate_hz` steps per second. Raises `SessionError` if it is damaged.

    windows: number of frames in the window of each serial; 1 for serials without entry.
    """
    phases, tracks, serials = phase_times(recording), dict[str, _Track](), set[str]()
    for message in lift_messages(recording):
        for name, value in _values(message, recording):
            track = tracks.setdefault(name, _Track())
            track.time_ns.append(message.time_ns)
            track.values.append(value)
            if isinstance(value, bytes):
                serials.add(message.source)
    if not serials or not {"pose", "joints", "gripper"} <= set(tracks):
        raise SessionError(f"{recording}: has no arm, gripper or image data; the session is damaged")
    estimate, truth = tracks.pop(FUSED, _Track()), tracks.pop(MARKERS, _Track())
    start = max(phases[Phase.GRASP], *(track.time_ns[0] for track in tracks.values()))
    count = (phases[Phase.LOWER] - start) * rate_hz // NS_PER_S
    if count < 1:
        raise SessionError(f"{recording}: has no data between grasp and end; the session is damaged")
    times = [start + step * NS_PER_S // rate_hz for step in range(count)]
    frames = {s: [tracks[_IMAGES + s].window(t, windows.get(s, 1)) for t in times] for s in sorted(serials)}
    wrench = tracks.get("wrench")
    state = [
        (*tracks["pose"].at(t), tracks["gripper"].at(t)[1], *(wrench.at(t) if wrench else ())) for t in times
    ]
    return Episode(
        {serial: [[jpeg for _, jpeg in window] for window in seen] for serial, seen in frames.items()},
        {serial: _ages_s(seen, times) for serial, seen in frames.items()},
        np.array(state, np.float32),
        (*POSE, tracks["gripper"].at(start)[0], *(WRENCH if wrench else ())),
        len(POSE) + 1,
        _angles(estimate, times),
        _angles(truth, times),
    )


def _values(message: LiftMessage, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the values of a message with the names of their tracks."""
    value = message.value
    if isinstance(value, bytes):
        yield _IMAGES + message.source, recorded_jpeg(value, path)
    elif isinstance(value, Pose):
        yield "pose", (*value.position_m, *value.quaternion_xyzw)
    elif isinstance(value, RecordedJoints):
        yield "joints", value.joints_rad
        if value.wrench is not None:
            yield "wrench", value.wrench
    elif isinstance(value, RecordedGripper):
        known = value.position_counts is not None
        yield (
            "gripper",
            ("gripper_counts", value.position_counts) if known else ("gripper_opening_m", value.opening_m),
        )
    elif isinstance(value, RecordedAngle) and message.source in (FUSED, MARKERS):
        yield message.source, (value.angle_deg, value.sigma_deg)


def _ages_s(windows: list[list[tuple[int, bytes]]], times: list[int]) -> Numbers:
    taken = np.array([[time_ns for time_ns, _ in window] for window in windows], np.int64)
    return ((np.array(times, np.int64)[:, None] - taken) / NS_PER_S).astype(np.float32)


def _angles(track: _Track, times: list[int]) -> Numbers:
    """Return the last known angle at each time, and the newest message's sigma and whether it has one."""
    rows, held = [], 0.0
    for angle, sigma in (track.at(t) or (None, None) for t in times):
        held = held if angle is None else angle
        sigma = UNKNOWN_SIGMA_DEG if angle is None or sigma is None else sigma
        rows.append((held, sigma, angle is not None))
    return np.array(rows, np.float32)


def export_lerobot(request: ExportRequest) -> Exported:
    """Write the data set. Raises `SessionError` for a session of rig record, `InputError` without pyarrow."""
    why = "a recording has images at rest, no episodes; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    pyarrow_modules()
    fps, lifts = round(manifest.config.require("camera").rate_hz), request.finished_lifts
    tasks = sorted({_task(lift) for lift in lifts})
    windows = {tip.serial: math.ceil(tip.rate_hz / fps) for tip in manifest.config.tactile}
    statistics = FeatureStatistics()
    episodes: list[Line] = []
    features: dict[str, dict[str, Any]] = {}
    first = 0
    for number, lift in enumerate(lifts):
        episode = read_episode(request.session / lift.recording, fps, windows)
        names = {serial: source_name(serial, manifest.config) for serial in episode.images}
        columns = _columns(episode, names, number, first, tasks.index(_task(lift)), fps)
        pictures = _pictures(episode, names, number)
        features = features or _features(episode, pictures, columns)
        _write_data(request.out, number, {**pictures, **columns}, features)
        for name, shown in pictures.items():
            for picture in shown[::EVERY_IMAGE]:
                image = decode_stored(picture["bytes"])
                statistics.add(name, image.reshape(-1, 3) / 255.0, 1, (3, 1, 1))
        for name, values in columns.items():
            numbers = np.asarray(values, np.float64).reshape(len(values), -1)
            statistics.add(name, numbers, len(numbers), (numbers.shape[1],))
        episodes.append(_episode_line(number, first, episode.steps, _task(lift)))
        first += episode.steps
    _write_meta(request, manifest, fps, features, tasks, episodes, first, statistics)
    note = f"{simulated_mark(request.manifest)}LeRobotDataset {FORMAT_VERSION}, {fps} steps a second"
    return Exported({"episodes": len(episodes), "frames": first, "tasks": len(tasks)}, (note,))


def _task(lift: Lift) -> str:
    return f"lift the {lift.name} and feel it turn"


def _features(
    episode: Episode, pictures: Mapping[str, list[StoredJpeg]], columns: Mapping[str, NDArray[Any]]
) -> dict[str, dict[str, Any]]:
    """Return type, shape and names of components of each column, as in `meta/info.json`."""
    features: dict[str, dict[str, Any]] = {}
    for key, shown in pictures.items():
        size = list(decode_stored(shown[0]["bytes"]).shape)
        features[key] = {"dtype": "image", "shape": size, "names": ["height", "width", "channels"]}
    known = {"observation.state": episode.names, "action": episode.names, "observation.angle": ANGLE_NAMES}
    for key, values in columns.items():
        size = list(values.shape[1:])
        names = [*known.get(key, [f"frame_{back}" for back in range(size[0])])][: size[0]] if size else None
        features[key] = {"dtype": str(values.dtype), "shape": size or [1], "names": names}
    return features


def _ages(episode: Episode, names: Mapping[str, str]) -> dict[str, Numbers]:
    """Return the ages of the frames in s, for each source with more than one frame per step."""
    windows = {f"observation.tactile.{names[s]}.age_s": ages for s, ages in episode.ages_s.items()}
    return {key: ages for key, ages in windows.items() if ages.shape[1] > 1}


def _pictures(episode: Episode, names: Mapping[str, str], number: int) -> dict[str, list[StoredJpeg]]:
    """Return the stored images by feature, one per step."""
    return {
        f"observation.tactile.{names[serial]}.{back}" if back else f"observation.images.{names[serial]}": [
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
        "angle.truth_deg": episode.truth[:, 0],
        "angle.truth_known": episode.truth[:, 2] > 0.0,
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
    features: Mapping[str, Mapping[str, Any]],
) -> None:
    arrow, parquet = pyarrow_modules()
    chunk, file = divmod(number, FILES_PER_CHUNK)
    path = out / DATA_PATH.format(chunk_index=chunk, file_index=file)
    path.parent.mkdir(parents=True, exist_ok=True)
    kinds = {
        "image": arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())]),
        "bool": arrow.bool_(), "float32": arrow.float32(), "int64": arrow.int64(),
    }  # fmt: skip

    def column(name: str) -> Any:
        values, dtype, shape = columns[name], features[name]["dtype"], features[name]["shape"]
        if dtype in ("image", "bool"):
            return arrow.array(list(values), kinds[dtype])
        if shape == [1]:
            return arrow.array(values, kinds[dtype])
        return arrow.array(np.asarray(values).tolist(), arrow.list_(kinds[dtype], shape[0]))

    # JPEGs cannot be compressed further; without compression the loader can memory-map them.
    table = arrow.Table.from_arrays([column(name) for name in features], names=list(features))
    parquet.write_table(table, path, compression="none", use_dictionary=False, row_group_size=100)


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


class FeatureStatistics:
    """Minimum, maximum, mean and standard deviation of each feature, accumulated over episodes.

    Statistics of vectors are per component, those of images per channel, scaled to 0..1. They are accumulated
    because the images of a session do not fit into memory. LeRobot's own code for this needs torch.
    """

    def __init__(self) -> None:
        self._sums: dict[str, tuple[list[Any], tuple[int, ...]]] = {}

    def add(self, name: str, values: NDArray[np.float64], count: int, shape: tuple[int, ...]) -> None:
        """Add (N, K) values. count: how many they count as. shape: of each figure in the file."""
        found = [values.min(0), values.max(0), values.sum(0), (values**2).sum(0), len(values), count]
        if name in self._sums:
            merged = (np.minimum, np.maximum, *[operator.add] * 4)
            known = self._sums[name][0]
            found = [merge(a, b) for merge, a, b in zip(merged, known, found, strict=True)]
        self._sums[name] = found, shape

    def as_json(self) -> dict[str, dict[str, Any]]:
        """Return `min`, `max`, `mean`, `std` and `count` of each feature, in LeRobot's format."""
        found: dict[str, dict[str, Any]] = {}
        for name, ((low, high, total, squares, rows, count), shape) in self._sums.items():
            mean = total / rows
            spread = np.sqrt(np.maximum(squares / rows - mean**2, 0.0))
            figures = {"min": low, "max": high, "mean": mean, "std": spread}
            found[name] = {key: v.reshape(shape).tolist() for key, v in figures.items()} | {"count": [count]}
        return found


def _write_meta(
    request: ExportRequest,
    manifest: TrialManifest,
    fps: int,
    features: Mapping[str, Mapping[str, Any]],
    tasks: list[str],
    episodes: list[Line],
    frames: int,
    statistics: FeatureStatistics,
) -> None:
    """Write `meta/` with statistics, and the card README.md.

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
        "features": features,
    }
    (out / EPISODES_PATH).parent.mkdir(parents=True)
    (out / "meta/info.json").write_text(json.dumps(info, indent=4))
    (out / "meta/stats.json").write_text(json.dumps(statistics.as_json(), indent=4))
    parquet.write_table(arrow.Table.from_pylist(episodes), out / EPISODES_PATH)
    parquet.write_table(_tasks_table(tasks), out / "meta/tasks.parquet")
    bench = manifest.config
    tips = [f"`finger_{t.finger.lower()}` {t.serial} (sign {t.sign:+d})" for t in bench.tactile]
    sources = ", ".join([*tips, f"`camera` {bench.require('camera').serial}"])
    mark = simulated_mark(manifest)
    (out / "README.md").write_text(
        CARD.format(
            session=request.session.name, mark=mark, version=manifest.tool_version, fps=fps, sources=sources
        )
    )


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
