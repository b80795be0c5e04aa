"""`rig benchmark slip`: processes of several versions, and figures of known clips, on tiny samples."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.errors import InputError, RigError
from rig.benchmark.clips.labelled import read_clips
from rig.benchmark.harness import Run
from rig.benchmark.measured import Measured
from rig.benchmark.slip import study
from rig.cli.main import app
from rig.frames.estimates import Estimate, zeroed
from rig.frames.series import TimedFrame
from rig.frames.times import FrameTime
from rig.tactile.sample import SlipSample, State
from support.angle_clips import FIRST_CONTACT, TURN_DEG, write_clip

OTHER_VERSION = """
import time
from types import SimpleNamespace

class Estimator:
    def update(self, image, time_s):
        if image.min() == 255:
            raise ValueError("a frame on which this version fails")
        since = time.process_time()
        while time.process_time() - since < COST_S:
            pass
        return SimpleNamespace(state=SimpleNamespace(value="tracking" if image.max() else "no_contact"))

def estimator(name, background, pixel_aspect=None, sign=1):
    return Estimator()
"""
"""Module `rig.tactile.estimators` of another version, whose estimator takes a known time."""


def write_version(folder: Path, cost_s: float) -> Path:
    (folder / "rig" / "tactile").mkdir(parents=True)
    (folder / "rig" / "tactile" / "__init__.py").touch()
    estimators = OTHER_VERSION.replace("COST_S", str(cost_s))
    (folder / "rig" / "tactile" / "estimators.py").write_text(estimators)
    (folder / "rig" / "__init__.py").write_text("from rig.tactile.estimators import estimator\n")
    return folder


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[study.Contender]]:
    """A fast and a slow version."""
    folder = tmp_path_factory.mktemp("versions")
    folders = [write_version(folder / name, cost_s) for name, cost_s in (("fast", 0.001), ("slow", 0.02))]
    with ExitStack() as stack:
        yield [stack.enter_context(closing(study.Contender("slip", each))) for each in folders]


def stored(folder: Path, greys: list[int]) -> Path:
    """Store frames of one grey level each."""
    shown = [np.full((8, 8, 3), grey, np.uint8) for grey in greys]
    frames = [TimedFrame("", FrameTime("", i * 10_000_000), image) for i, image in enumerate(shown)]
    study.store(folder / "frames.npz", np.zeros((8, 8, 3), np.uint8), frames)
    return folder / "frames.npz"


def test_versions_are_timed_on_frames_with_contact(tmp_path: Path, versions: list[study.Contender]) -> None:
    fast_ms, slow_ms = study.contact_ms(versions, [stored(tmp_path, [0, 1, 0, 1, 1])])
    assert (len(fast_ms), len(slow_ms)) == (3, 3)
    assert min(fast_ms) >= 1.0
    assert min(slow_ms) >= max(20.0, 2.0 * min(fast_ms))


def test_late_frames_of_streams_are_dropped(tmp_path: Path, versions: list[study.Contender]) -> None:
    streams, (fast, slow) = [[str(stored(tmp_path, [1] * 6))]] * 2, versions
    frames, dropped, longest_ms = fast.ask("stream", streams, 4.0)
    assert (frames, dropped) == (12, 0)
    assert longest_ms >= 1.0
    frames, dropped, longest_ms = slow.ask("stream", [[*files * 5] for files in streams], 50.0)
    assert frames == 60
    assert 20 <= dropped < 60  # needs 40 ms for the frames of 20 ms
    assert longest_ms >= 20.0


@pytest.mark.parametrize("options", [{"clips": Path("nowhere")}, {"turns": [Path("nowhere")]}])
def test_missing_set_is_an_error_before_the_lifts(options: dict[str, Any]) -> None:
    progress: list[str] = []
    with pytest.raises(InputError, match="nowhere: there is no such folder"):
        study.measure(study.SlipOptions(**options), Run(jobs=1, progress=lambda *of: progress.append(of[2])))
    assert progress == []


def test_missing_or_failing_version_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no slip rig"):
        study.Contender("slip", tmp_path)
    version = write_version(tmp_path / "broken", 0.0)
    with (
        closing(study.Contender("slip", version)) as started,
        pytest.raises(RigError, match="slip in broken"),
    ):
        study.contact_ms([started], [stored(tmp_path, [255])])


def test_largest_change_ignores_refused_frames() -> None:
    angles = [0.0, 1.0, None, 50.0, 46.0]
    samples = [SlipSample(round(i * 1e8), State.TRACKING, angle) for i, angle in enumerate(angles)]
    times = [FrameTime(str(of.time_s), of.time_ns) for of in samples]
    assert study.largest_change_deg_s(zeroed(Estimate(tuple(times), tuple(samples)), None)) == pytest.approx(
        40.0
    )
    assert study.largest_change_deg_s(zeroed(Estimate((times[2],), (samples[2],)), None)) == 0.0


def test_size_counts_lines_constants_and_parameters(tmp_path: Path) -> None:
    package = tmp_path / "slip"
    package.mkdir()
    (package / "one.py").write_text("A, B = 1, 2.0\nNAME = 'x'\nFLAG = True\n\ndef f():\n    C = 3\n")
    (package / "two.py").write_text("D = math.radians(200.0)\n")
    (tmp_path / "slip.json").write_text('{"parameters": {"one": {"a": 1, "b": 2}, "two": {"c": 3}}}')
    lines, constants = study.size_rows(package, tmp_path / "slip.json")
    assert (lines.name, lines.value) == ("lines of slip", 7)
    assert (constants.name, constants.value) == ("constants (3) and parameters (3) of slip", 6)


@pytest.fixture(scope="module")
def clips(press: Callable[..., Any], blank: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a clip of known angles, and its group."""
    folder = tmp_path_factory.mktemp("clips")
    clip = write_clip(folder / "bar", press, blank)
    rows = [f"{FIRST_CONTACT},{FIRST_CONTACT + i},{turn},0.5" for i, turn in enumerate(TURN_DEG) if turn]
    columns = "reference_frame,keyframe,angle_deg,sigma_deg"
    (clip / "labels.csv").write_text("\n".join([columns, f"{FIRST_CONTACT},{FIRST_CONTACT},0,0.5", *rows]))
    times = [f"{i},{i / 10}" for i in range(FIRST_CONTACT + len(TURN_DEG))]
    (clip / "timestamps.csv").write_text("\n".join(["frame,t_s", *times]))
    (folder / "groups.csv").write_text("clip,group\nbar,development\n")
    return folder


@pytest.fixture(scope="module")
def rows(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Measured]:
    other = write_version(tmp_path_factory.mktemp("other"), 0.02)
    few = study.SlipOptions(clips, [clips], clips / "groups.csv", against=[other], lifts=0, drawn=0)
    return {row.name: row for row in study.measure(few, Run(jobs=1)).limits}


@pytest.mark.heavy
def test_known_clip_meets_limits(rows: dict[str, Measured], clips: Path) -> None:
    labels = 4 * len(read_clips(clips)[0].labels)
    for name in ("within 3 degrees or 2 label sigmas", "useful"):
        row = rows[f"{labels} labels, development, {name}"]
        assert (row.value, row.met) == (1.0, True)
    assert rows[f"{labels} labels, development, confidently wrong"].value == 0.0
    assert rows[f"{labels // 4} labels, turns without printed dots, useful"].value == 1.0
    assert rows["largest change between two frames of clips, degrees per second"].met


@pytest.mark.heavy
def test_missing_data_are_named(rows: dict[str, Measured]) -> None:
    missing = {row.name: row.asked for row in rows.values() if row.asked.startswith("no data")}
    assert missing == {
        "SIMULATED lifts, ms per frame with contact": "no data: see --lifts",
        "labels, validation": "no data: see --clips",
        "labels, turns with printed dots": "no data: see --turns",
        "SIMULATED by the second renderer, worst lift, degrees": "no data: see --drawn",
        "SIMULATED, 0 lifts on bench fake, MARE, degrees": "no data: see --lifts",
        "SIMULATED, 0 lifts on bench hard, MARE, degrees": "no data: see --lifts",
    }


@pytest.mark.heavy
def test_limits_of_times_are_relative_to_another_version(rows: dict[str, Measured]) -> None:
    times = [row for row in rows.values() if row.name.startswith("clips, ms per frame")]
    assert [row.asked for row in times] == [""] * 4
    own, other = (row.value for row in times if "median" in row.name)
    assert 20.0 <= other < 30.0
    ratios = [row for row in rows.values() if "as a fraction" in row.name]
    assert [row.asked for row in ratios] == ["at most 0.28", "at most 0.25"]
    assert ratios[0].value == pytest.approx(own / other)


@pytest.mark.heavy
@pytest.mark.parametrize(("options", "code"), [((), 0), (("--limits",), 4)])
def test_missed_limits_end_with_exit_code_4_on_request(options: tuple[str, ...], code: int) -> None:
    command = ["benchmark", "slip", "--lifts", "0", "--drawn", "0", "--json", *options]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == code, result.output
    values = json.loads(result.stdout)
    assert values["options"]["turns"] is None
    assert ("limit missed: lines of slip" in result.stderr) == bool(options)
    assert {row["name"]: row["met"] for row in values["limits"]}["lines of slip"] is False
