"""A trial as a LeRobotDataset, format 3.0: an episode per lift, a file per episode.

Format: huggingface/lerobot, `datasets/lerobot_dataset.py` and `datasets/utils.py` of version 0.4.
Images stay the stored JPEGs, inside the Parquet files (feature type "image"): a video codec would
change the shades that the estimators live on.
"""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from rig.export.episodes import Episode, read_episode
from rig.export.lerobot_meta import DATA_PATH, FILES_PER_CHUNK, FORMAT_VERSION, write_meta
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.export.statistics import FeatureStatistics
from rig.sessions.images import decoded
from rig.sessions.table_files import pyarrow_modules

STATE_NAMES = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "gripper_counts")
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
"""Of the images, each so-many-th goes into the statistics."""


def export_lerobot(request: ExportRequest) -> Exported:
    """Write the data set. Raises `InputError` for a recording or without pyarrow, `SessionError`."""
    if request.kind != "trial":
        raise InputError(
            f"{request.session}: a recording has images at rest, no episodes; use --to coco or labelme"
        )
    pyarrow_modules()
    fps = round(request.manifest["config"]["camera"]["rate_hz"])
    tasks = sorted({_task(row) for row in request.accepted})
    statistics = FeatureStatistics()
    episodes: list[dict[str, Any]] = []
    features: dict[str, Any] = {}
    for number, row in enumerate(request.accepted):
        episode = read_episode(request.session / row["recording"], fps)
        features = features or _features(request, episode)
        first = episodes[-1]["dataset_to_index"] if episodes else 0
        columns = _columns(request, episode, number, first, tasks.index(_task(row)), fps)
        _write_data(request.out, number, columns, features)
        _count(statistics, columns, features)
        episodes.append(_episode_line(number, first, episode.steps, _task(row)))
    write_meta(request, fps, features, tasks, episodes, statistics)
    frames = episodes[-1]["dataset_to_index"]
    note = f"{simulated_mark(request.manifest)}LeRobotDataset {FORMAT_VERSION}, {fps} steps a second"
    return Exported({"episodes": len(episodes), "frames": frames, "tasks": len(tasks)}, (note,))


def _task(row: dict[str, Any]) -> str:
    return f"lift the {row['name']} and feel it turn"


def _image_key(request: ExportRequest, serial: str) -> str:
    camera = request.manifest["config"]["camera"]["serial"]
    return f"observation.images.{'camera' if serial == camera else serial}"


def _features(request: ExportRequest, episode: Episode) -> dict[str, Any]:
    """Return the features as `meta/info.json` lists them."""
    features: dict[str, Any] = {}
    for serial, pictures in episode.images.items():
        height, width = decoded(pictures[0]).shape[:2]
        names = ["height", "width", "channels"]
        features[_image_key(request, serial)] = {
            "dtype": "image",
            "shape": [height, width, 3],
            "names": names,
        }
    vector = {"dtype": "float32", "shape": [len(STATE_NAMES)], "names": list(STATE_NAMES)}
    features |= {"observation.state": vector, "action": vector}
    return features | {
        name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in {**SCALARS, **COUNTERS}.items()
    }


def _columns(
    request: ExportRequest, episode: Episode, number: int, first: int, task: int, fps: int
) -> dict[str, Any]:
    """Return an episode's columns, each with one value per step."""
    steps = np.arange(episode.steps)
    images = {
        _image_key(request, serial): [
            {"bytes": jpeg, "path": f"{serial}-{number:03d}-{step:06d}.jpg"}
            for step, jpeg in enumerate(jpegs)
        ]
        for serial, jpegs in episode.images.items()
    }
    return {
        **images,
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


def _write_data(out: Path, number: int, columns: dict[str, Any], features: dict[str, Any]) -> None:
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
        if feature["dtype"] in kinds:
            return arrow.array(list(columns[name]), kinds[feature["dtype"]])
        kind = {"float32": arrow.float32(), "int64": arrow.int64()}[feature["dtype"]]
        if feature["shape"] == [1]:
            return arrow.array(columns[name], kind)
        return arrow.array(columns[name].tolist(), arrow.list_(kind, feature["shape"][0]))

    # JPEGs do not compress; without compression the loader maps them as they are.
    table = arrow.Table.from_arrays([column(name) for name in features], names=list(features))
    parquet.write_table(table, path, compression="none", use_dictionary=False, row_group_size=100)


def _count(statistics: FeatureStatistics, columns: dict[str, Any], features: dict[str, Any]) -> None:
    for name, feature in features.items():
        if feature["dtype"] == "image":
            for picture in columns[name][::EVERY_IMAGE]:
                statistics.add_image(name, decoded(picture["bytes"]))
        else:
            statistics.add(name, np.asarray(columns[name], np.float64).reshape(len(columns[name]), -1))


def _episode_line(number: int, first: int, steps: int, task: str) -> dict[str, Any]:
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
