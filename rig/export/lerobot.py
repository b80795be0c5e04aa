"""A trial as a LeRobotDataset, format 3.0: an episode per lift, a file per episode.

Format: huggingface/lerobot, `datasets/lerobot_dataset.py` and `datasets/utils.py` of version 0.4.
Images stay the stored JPEGs, inside the Parquet files (feature type "image"): a video codec would
change the shades that the estimators live on.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from drivers.images import decode_stored
from rig.export.episodes import Episode, read_episode
from rig.export.lerobot_meta import (
    DATA_PATH,
    FILES_PER_CHUNK,
    FORMAT_VERSION,
    Feature,
    FeatureStatistics,
    write_meta,
)
from rig.export.result import Exported, ExportRequest, simulated_mark, source_name
from rig.sessions.manifest import TrialManifest, require_kind
from rig.sessions.records import FinishedLift
from rig.sessions.table_files import Line, pyarrow_modules

STATE_NAMES = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
SCALARS = {
    "angle.estimate_deg": "float32",
    "angle.estimate_known": "bool",
    "angle.truth_deg": "float32",
    "angle.truth_known": "bool",
}
COUNTERS = {
    "timestamp": "float32",
    **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
}
EVERY_IMAGE = 30
"""Every Nth image is included in the statistics."""


class StoredJpeg(TypedDict):
    """A stored JPEG as the data set holds it, with the name it would have as a file."""

    bytes: bytes
    path: str


def export_lerobot(request: ExportRequest) -> Exported:
    """Write the data set. Raises `SessionError` for a recording, `InputError` without pyarrow."""
    why = "a recording has images at rest, no episodes; use --to coco or labelme"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    pyarrow_modules()
    fps, lifts = round(manifest.config.camera.rate_hz), request.finished_lifts
    tasks = sorted({_task(lift) for lift in lifts})
    statistics = FeatureStatistics()
    episodes: list[Line] = []
    features: dict[str, Feature] = {}
    first = 0
    for number, lift in enumerate(lifts):
        episode = read_episode(request.session / lift.recording, fps)
        keys = {s: f"observation.images.{source_name(s, manifest.config)}" for s in episode.images}
        features = features or _features(episode, keys)
        columns = _columns(episode, number, first, tasks.index(_task(lift)), fps)
        pictures = {key: _pictures(episode, serial, number) for serial, key in keys.items()}
        _write_data(request.out, number, {**pictures, **columns}, features)
        _count(statistics, pictures, columns)
        episodes.append(_episode_line(number, first, episode.steps, _task(lift)))
        first += episode.steps
    write_meta(request, fps, features, tasks, episodes, first, statistics)
    note = f"{simulated_mark(request.manifest)}LeRobotDataset {FORMAT_VERSION}, {fps} steps a second"
    return Exported({"episodes": len(episodes), "frames": first, "tasks": len(tasks)}, (note,))


def _task(lift: FinishedLift) -> str:
    return f"lift the {lift.name} and feel it turn"


def _features(episode: Episode, keys: Mapping[str, str]) -> dict[str, Feature]:
    """Return the features as `meta/info.json` lists them. keys: of the images by serial."""
    features: dict[str, Feature] = {}
    for serial, pictures in episode.images.items():
        height, width = decode_stored(pictures[0]).shape[:2]
        features[keys[serial]] = Feature("image", [height, width, 3], ["height", "width", "channels"])
    names = [*STATE_NAMES, episode.gripper]
    vector = Feature("float32", [len(names)], names)
    features |= {"observation.state": vector, "action": vector}
    return features | {name: Feature(dtype, [1], None) for name, dtype in {**SCALARS, **COUNTERS}.items()}


def _pictures(episode: Episode, serial: str, number: int) -> list[StoredJpeg]:
    """Return a source's stored images, one per step."""
    return [
        {"bytes": jpeg, "path": f"{serial}-{number:03d}-{step:06d}.jpg"}
        for step, jpeg in enumerate(episode.images[serial])
    ]


def _columns(episode: Episode, number: int, first: int, task: int, fps: int) -> dict[str, NDArray[Any]]:
    """Return an episode's numbers, each with one value per step."""
    steps = np.arange(episode.steps)
    return {
        "observation.state": episode.state,
        "action": np.concatenate([episode.state[1:], episode.state[-1:]]),
        "angle.estimate_deg": episode.estimate_deg,
        "angle.estimate_known": episode.estimate_known,
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

    # JPEGs do not compress; without compression the loader maps them as they are.
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
