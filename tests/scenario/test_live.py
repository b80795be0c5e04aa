"""Trials with a live view: it shows every source and the whole curves, and it changes no result."""

import sys
import threading
import time
from pathlib import Path

import pytest

from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.live.feed import Listener
from rig.live.session import _viewer
from rig.sessions.reading import recorded_angles
from rig.sessions.rows import read_finished_lifts
from rig.tactile.angles import FUSED
from rig.tactile.estimators import choose_estimator
from support.benches import short_phases

pytest.importorskip("rerun", reason="the live view's library is not installed: extra 'live'")


WRITING_VIEWER = """if True:
    import sys
    import rerun
    from rig.live.viewer import main
    file, address = sys.argv[1:]
    def save(stream, memory_limit, default_blueprint):
        stream.save(file, default_blueprint=default_blueprint)
    rerun.RecordingStream.spawn = save
    main(address)
"""
"""The process of the viewer, with a file in place of the window, which needs a display."""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What viewers show from now on is written to this file."""
    file = tmp_path / "lift.rrd"

    def command(*words: str) -> list[str]:
        return [sys.executable, "-c", WRITING_VIEWER, str(file), words[-1]]

    monkeypatch.setattr("rig.live.session.python_command", command)
    return file


def lift_once(folder: Path, bench: BenchConfig, live: list[Listener]) -> None:
    with short_phases():
        run_trial(folder, TrialSettings(bench, 0, choose_estimator("slip")), ["t2"], lifts=1, live=live)


def same(one: Path, other: Path) -> bool:
    names = ("lifts.jsonl", "lifts.csv", "lifts/001.mcap")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


@pytest.mark.heavy
def test_viewer_gets_images_markers_arm_and_whole_curves(
    one_lift: Path, light_bench: BenchConfig, tmp_path: Path, file: Path
) -> None:
    from rerun.chunk import RrdReader

    address = str(tmp_path / "viewer")
    with _viewer(address):
        lift_once(tmp_path / "s", light_bench, [Listener(address, pictures=True)])
    assert same(tmp_path / "s", one_lift)
    reader = RrdReader(file)
    assert [entry.application_id for entry in reader.recordings()] == ["slip_rig"]
    rows: dict[str, int] = {}
    for chunk in reader.stream().to_chunks():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    pictures = {"/camera", "/tactile/SIM-D0001", "/tactile/SIM-D0002"}
    assert pictures | {"/camera/markers", "/arm/tcp", "/events", "/angle/estimate"} <= set(rows)
    answered = len(recorded_angles(one_lift / "lifts/001.mcap", FUSED)[FUSED].known)
    # a further row has the style of the curve; a message may be lost, ten figures at a time
    assert answered // 2 < rows["/angle/estimate"] <= answered + 1
    row = read_finished_lifts(one_lift)[0]
    assert rows["/camera"] <= row.frames["camera"]


@pytest.mark.heavy
def test_a_killed_viewer_changes_nothing(
    one_lift: Path, light_bench: BenchConfig, tmp_path: Path, file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    address = str(tmp_path / "viewer")
    with _viewer(address) as process:
        size = file.stat().st_size

        def kill_in_mid_lift() -> None:
            while file.stat().st_size <= size + 10_000:
                time.sleep(0.01)
            process.kill()

        killer = threading.Thread(target=kill_in_mid_lift, daemon=True)
        killer.start()
        lift_once(tmp_path / "s", light_bench, [Listener(address, pictures=True)])
        killer.join(timeout=120)
        assert process.wait(10.0) != 0
    assert "ended before the command did" in caplog.text
    assert same(tmp_path / "s", one_lift)
