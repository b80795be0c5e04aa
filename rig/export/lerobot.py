"""Export a trial as a LeRobotDataset, format 3.0: an episode per lift, a file per episode.

A row is a time step at the rate of the camera. The format has one image per row and feature. If fingertips
are faster than the camera, their earlier frames since the last step are further features of type "image".

Format: huggingface/lerobot, `datasets/lerobot_dataset.py` and `datasets/utils.py` of version 0.4. The stored
JPEGs are copied into the Parquet files (feature type "image"), because a video codec would change the small
differences in brightness that the estimators use.
"""

import math
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
from rig.sessions.records import Lift
from rig.sessions.table_files import Line, pyarrow_modules

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
