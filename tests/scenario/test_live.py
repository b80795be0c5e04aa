"""Trials with a live view: the file opens in rerun, and the view changes no result."""

import threading
import time
from pathlib import Path

import pytest

from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.live.feed import Listener, LiveFeed
from rig.live.session import _viewer, viewer_feed
from rig.sessions.reading import recorded_angles
from rig.sessions.recorder import FUSED_TOPIC
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator

pytest.importorskip("rerun", reason="the live view's library is not installed: extra 'live'")


def lift_once(folder: Path, bench: BenchConfig, live: LiveFeed) -> None:
    run_trial(folder, TrialSettings(bench, 0, choose_estimator("slip")), ["t2"], lifts=1, live=live)


def same(one: Path, other: Path) -> bool:
    names = ("lifts.jsonl", "lifts.csv", "lifts/001.mcap")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


def test_the_file_opens_in_rerun_with_pictures_markers_arm_and_the_whole_curves(
    one_lift: Path, light_bench: BenchConfig, tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    file = tmp_path / "lift.rrd"
    with viewer_feed(file) as feed:
        lift_once(tmp_path / "s", light_bench, feed)
    assert same(tmp_path / "s", one_lift)
    reader = RrdReader(file)
    assert [entry.application_id for entry in reader.recordings()] == ["slip_rig"]
    rows: dict[str, int] = {}
    for chunk in reader.stream().to_chunks():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    pictures = {"/camera", "/tactile/SIM-D0001", "/tactile/SIM-D0002"}
    assert pictures | {"/camera/markers", "/arm/tcp", "/events", "/angle/estimate"} <= set(rows)
    stored = recorded_angles(one_lift / "lifts/001.mcap", FUSED_TOPIC)[FUSED_TOPIC]
    answered = sum(value.angle_deg is not None for value in stored)
    # a further row has the style of the curve; a message may be lost, ten figures at a time
    assert answered // 2 < rows["/angle/estimate"] <= answered + 1
    row = read_finished_lifts(one_lift)[0]
    assert rows["/camera"] <= row.frames["camera"]


def test_a_killed_viewer_changes_nothing(
    one_lift: Path, light_bench: BenchConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "lift.rrd"
    address = str(tmp_path / "viewer")
    with _viewer(address, str(file)) as process:
        size = file.stat().st_size

        def kill_in_mid_lift() -> None:
            while file.stat().st_size <= size + 10_000:
                time.sleep(0.01)
            process.kill()

        killer = threading.Thread(target=kill_in_mid_lift, daemon=True)
        killer.start()
        lift_once(tmp_path / "s", light_bench, LiveFeed((Listener(address, pictures=True),)))
        killer.join(timeout=120)
        assert process.wait(10.0) != 0
    assert "ended before the command did" in caplog.text
    assert same(tmp_path / "s", one_lift)
