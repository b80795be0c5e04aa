"""What arms of others said while they were recorded, through the arm's status decoding.

Files that UR's own `record.py` wrote (RTDE outputs, 125 Hz, CSV), and UCI's data set 963, "UR3 CobotOps",
whose column says where a protective stop was. A recording has `safety_status`, a number; the driver reads
its bits.
"""

import csv
import importlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.errors import ProtectiveStopError
from drivers.types import ArmMode
from drivers.ur5e.shared_state import StateSample
from drivers.ur5e.status import PLAYING, RUNNING_MODE, arm_mode, program_reason, stop_reason
from rig.benchmark.others.rows import Row, Say, clone_of, commit_of, how_to_clone, installed, skipped

PART = "recordings"
CSV_PLACE = "examples/robot_data.csv"
RECORDED = ("porrasp8/RTDE_PYTHON_CLIENT_LIB_EXPANDED", "SuperArbor/rtde-2.6.0", "nour427/TSSP-2024")
UCI_FOLDER, UCI_FILE = "uci/ur3_cobotops", "dataset_02052023.xlsx"
_SAFETY_BIT = {1: 0, 2: 1, 3: 2, 4: 3, 5: 4, 6: 5, 7: 6, 8: 8, 9: 9}
"""safety_status to its bit in safety_status_bits (Universal Robots, RTDE Guide); other values have none."""
_PROTECTIVE_STOP = 3
_SIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Said:
    """A line of a recording: what it says, as numbers of RTDE."""

    time_s: float
    safety_status: int
    robot_mode: int
    runtime_state: int


def run_recordings(clones: Path | None, say: Say) -> list[Row]:
    """A row for each recording; what is not there is skipped."""
    return [*(_recorded(repository, clones, say) for repository in RECORDED), _uci(clones, say)]


def _recorded(repository: str, clones: Path | None, say: Say) -> Row:
    what = f"{repository}: {CSV_PLACE}"
    clone = clone_of(repository, clones)
    if clone is None or not (clone / CSV_PLACE).is_file():
        return skipped(PART, what, how_to_clone(repository))
    say(what)
    lines = list(_csv_lines(clone / CSV_PLACE))
    return _row(what, commit_of(clone), lines)


def _uci(clones: Path | None, say: Say) -> Row:
    what = "UCI data set 963, UR3 CobotOps"
    folder = clone_of(UCI_FOLDER, clones)
    if folder is None or not (folder / UCI_FILE).is_file():
        return skipped(PART, what, f"archive.ics.uci.edu/dataset/963, {UCI_FILE} into CLONES/{UCI_FOLDER}")
    if installed("openpyxl") is None or installed("pandas") is None:
        return skipped(PART, what, "pip install pandas openpyxl")
    say(what)
    return _row(what, "2024", list(_uci_lines(folder / UCI_FILE)))


def _row(what: str, version: str, lines: list[_Said]) -> Row:
    samples = [_sample(line) for line in lines]
    stops = [isinstance(stop_reason(sample), ProtectiveStopError) for sample in samples]
    said = [line.safety_status == _PROTECTIVE_STOP for line in lines]
    modes = Counter(arm_mode(sample) for sample in samples)
    period_s = (lines[-1].time_s - lines[0].time_s) / (len(lines) - 1)
    ended = sum(s.runtime_state != PLAYING and program_reason(s) is not None for s in samples)
    result = (
        f"{len(lines)} states, {1 / period_s:.0f} Hz: {modes[ArmMode.RUNNING]} running, "
        f"{ended} without a program that runs; moments of a protective stop"
    )
    return Row(PART, what, version, result, str(sum(stops)), str(sum(said)), met=stops == said)


def _sample(line: _Said) -> StateSample:
    bit = _SAFETY_BIT.get(line.safety_status)
    return StateSample(
        timestamp_s=line.time_s, received_ns=0, sampled_ns=0, joints_rad=_SIX, pose=_SIX, speed=_SIX,
        wrench=_SIX, payload_kg=0.0, payload_cog_m=(0.0, 0.0, 0.0), speed_fraction=1.0,
        robot_mode=line.robot_mode, safety_bits=0 if bit is None else 1 << bit, status_bits=0,
        runtime_state=line.runtime_state, samples=1, gaps=0,
    )  # fmt: skip


def _csv_lines(path: Path) -> Iterator[_Said]:
    with path.open(newline="") as stream:
        for row in csv.DictReader(stream, delimiter=" "):
            # safety_mode is what the output was called before PolyScope 3.10
            status = row.get("safety_status") or row["safety_mode"]
            numbers = (int(value) for value in (status, row["robot_mode"], row["runtime_state"]))
            yield _Said(float(row["timestamp"]), *numbers)


def _uci_lines(path: Path) -> Iterator[_Said]:
    """Lines with a reading of the protective stop; the arm's mode and program are not in this set."""
    pandas: Any = importlib.import_module("pandas")
    table = pandas.read_excel(path)
    table = table[table["Robot_ProtectiveStop"].notna()]
    texts = (str(text).strip('"') for text in table["Timestamp"])  # some of its times stand in quotes
    times_s = (datetime.fromisoformat(text).timestamp() for text in texts)
    for time_s, stopped in zip(times_s, table["Robot_ProtectiveStop"], strict=True):
        yield _Said(time_s, _PROTECTIVE_STOP if stopped else 1, RUNNING_MODE, PLAYING)
