"""`rig benchmark others`: foreign clients and file readers on the rig's wire protocols and files."""

import contextlib
import importlib
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import RigError, counted, unknown_name
from rig.benchmark.harness import Report, Run, Study, Table, option, table_of
from rig.benchmark.measured import at_most
from rig.benchmark.others.clients import Row, installed, output, run_clients, skipped
from rig.export.formats import export_session


@dataclass(frozen=True, slots=True)
class OthersOptions:
    """Options of `rig benchmark others`: where clients and readers find their input."""

    part: list[str] | None = option(None, "clients or files; repeat. Default: both.")
    clones: Path | None = option(None, "Folder with clones of public repositories, as OWNER/NAME.")
    session: Path | None = option(None, "A session of rig trial, whose files are opened.")


PARTS: dict[str, Callable[[OthersOptions, Run], list[Row]]] = {
    "clients": lambda options, run: run_clients(options.clones, run),
    "files": lambda options, run: run_files(options.session, run),
}


def measure(options: OthersOptions, run: Run) -> Report:
    """Run third-party clients on the simulated devices, and third-party readers on session files.

    Each client and reader is a package or clone that is not part of the rig. If it is missing, its row is
    skipped and shows how to install it. All connections are on loopback. See docs/others.md. The exit code is
    4 if a result is not as expected.

    Examples:
      rig benchmark others --part clients

      rig benchmark others --clones clones/ --session my_session --json

    """
    rows: list[Row] = []
    for part in options.part or PARTS:
        if part not in PARTS:
            raise unknown_name("part", part, PARTS)
    for part in options.part or PARTS:
        try:
            rows += PARTS[part](options, run)
        except RigError as error:
            rows.append(Row(part, "the part itself", "", str(error), met=False))
    table = others_table(rows)
    wrong = [row for row in rows if row.met is False]
    return Report(
        tables=(table,),
        limits=(at_most("results that are not as expected", len(wrong), 0),),
        limits_of="foreign clients and readers",
        notes=[f"not as expected: {row.part}, {row.what}: {row.result}" for row in wrong],
        section=table.markdown(),
    )


def others_table(rows: Sequence[Row]) -> Table:
    """Return the table with a row for each client and reader."""
    return table_of("Foreign clients and file readers", Row, rows, left=5)


STUDY = Study(
    name="others",
    options=OthersOptions,
    measure=measure,
    cases="parts",
    shared=("readme",),
    simulated=False,
)


PART = "files"
Reader = Callable[[Path, Path], tuple[bool, str]]
"""Reads a recording, with a folder for exports; returns whether it is as expected, and what was read."""


def run_files(session: Path | None, run: Run) -> list[Row]:
    """Return a row for each reader. They need a session of `rig trial`."""
    if session is None:
        return [skipped(PART, "recordings and exports", "rig trial --lifts 1 --out S, then --session S")]
    recording = sorted((session / "lifts").glob("*.mcap"))[0]
    readers: list[tuple[str, str, Reader]] = [
        ("mcap and foxglove's schemas", "mcap", _foxglove), ("rerun", "rerun-sdk", _rerun),
        ("pandas, of Parquet", "pandas", _pandas), ("duckdb, of Parquet", "duckdb", _duckdb),
        ("pycocotools, of COCO", "pycocotools", _coco), ("labelme, of LabelMe's files", "labelme", _labelme),
        ("LeRobotDataset", "lerobot", _lerobot),
    ]  # fmt: skip
    rows = [_doctor(recording)]
    for name, package, read in readers:
        version = installed(package)
        if version is None:
            rows.append(skipped(PART, name, f"pip install {package}"))
            continue
        run.say(f"{name} {version}")
        rows.append(_read(name, version, read, recording))
    return rows


def _read(name: str, version: str, read: Reader, recording: Path) -> Row:
    # the output of a reader must not mix with the table or with --json
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        try:
            met, result = read(recording, Path(folder))
        except ImportError as error:
            return skipped(PART, name, f"version {version} has another interface ({error})")
        except Exception as error:
            met, result = False, f"{type(error).__name__}: {error}"
    return Row(PART, name, version, result, met=met)


def _doctor(recording: Path) -> Row:
    """Run MCAP's command line tool."""
    tool = shutil.which("mcap")
    if tool is None:
        return skipped(PART, "mcap doctor", "the program mcap is not on the PATH (github.com/foxglove/mcap)")
    _, version = output([tool, "version"])
    code, said = output([tool, "doctor", str(recording)])
    return Row(PART, "mcap doctor", version, said or "no complaint", met=code == 0)


def _foxglove(recording: Path, folder: Path) -> tuple[bool, str]:
    reader: Any = importlib.import_module("mcap.reader")
    factory: Any = importlib.import_module("mcap_protobuf.decoder").DecoderFactory()
    seen: Counter[str] = Counter()
    with recording.open("rb") as stream:
        for schema, _, message in reader.make_reader(stream).iter_messages():
            if schema is not None and schema.encoding == "protobuf":
                factory.decoder_for("protobuf", schema)(message.data)
                seen[schema.name] += 1
    counts = ", ".join(f"{count} {name}" for name, count in sorted(seen.items()))
    return {"foxglove.CompressedImage", "foxglove.PoseInFrame"} <= seen.keys(), f"decoded {counts}"


def _rerun(recording: Path, folder: Path) -> tuple[bool, str]:
    reader: Any = importlib.import_module("rerun.chunk")
    paths = {chunk.entity_path for chunk in reader.McapReader(recording).stream().to_chunks()}
    return "/arm/tcp" in paths and sum(p.startswith("/image/") for p in paths) == 3, f"{len(paths)} entities"


def _parquet(recording: Path, folder: Path) -> Path:
    export_session(recording.parents[1], "parquet", folder / "tables")
    return folder / "tables" / "angles.parquet"


def _pandas(recording: Path, folder: Path) -> tuple[bool, str]:
    pandas: Any = importlib.import_module("pandas")
    table = pandas.read_parquet(_parquet(recording, folder))
    return len(table) > 0, f"{len(table)} angles of {len(table.columns)} columns"


def _duckdb(recording: Path, folder: Path) -> tuple[bool, str]:
    duckdb: Any = importlib.import_module("duckdb")
    path = str(_parquet(recording, folder))
    count = duckdb.execute("SELECT count(*) FROM read_parquet(?)", [path]).fetchone()[0]
    return count > 0, f"{count} angles"


def _coco(recording: Path, folder: Path) -> tuple[bool, str]:
    coco: Any = importlib.import_module("pycocotools.coco")
    export_session(recording.parents[1], "coco", folder / "coco")
    document = next((folder / "coco").rglob("*.json"))
    data = coco.COCO(str(document))
    areas = [int(data.annToMask(annotation).sum()) for annotation in data.loadAnns(data.getAnnIds())]
    return bool(areas) and min(areas) > 0, f"{len(data.imgs)} images, {len(areas)} masks"


def _labelme(recording: Path, folder: Path) -> tuple[bool, str]:
    module: Any = importlib.import_module("labelme._label_file")
    export_session(recording.parents[1], "labelme", folder / "labelme")
    files = [module.LabelFile(str(path)) for path in sorted((folder / "labelme").rglob("*.json"))]
    shapes = sum(len(file.shapes) for file in files)
    return bool(shapes) and all(file.imageData for file in files), f"{len(files)} images, {shapes} shapes"


def _lerobot(recording: Path, folder: Path) -> tuple[bool, str]:
    module: Any = importlib.import_module("lerobot.datasets.lerobot_dataset")
    export_session(recording.parents[1], "lerobot", folder / "lerobot")
    data = module.LeRobotDataset("local/session", root=folder / "lerobot")
    first, last = data[0], data[len(data) - 1]
    images = [key for key in first if key.startswith("observation.images.")]
    whole = bool(images) and all(tuple(first[key].shape) == tuple(last[key].shape) for key in images)
    episodes, frames = counted(data.num_episodes, "episode"), counted(len(data), "frame")
    return whole, f"{episodes}, {frames} at {data.fps} Hz, {len(images)} cameras"
