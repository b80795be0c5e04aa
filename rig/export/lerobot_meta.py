"""Write the metadata of a LeRobotDataset: `meta/` with statistics, and the card README.md."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.export.result import ExportRequest, simulated_mark
from rig.sessions.table_files import Line, pyarrow_modules

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
