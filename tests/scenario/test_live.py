"""Trials that are looked at: the file opens in rerun, and looking changes nothing."""

import threading
import time
from pathlib import Path

import pytest

from rig.attempt import TrialSettings
from rig.benchmark.wire import measure_wire
from rig.config import BenchConfig, load_bench
from rig.live.feed import Listener, LiveFeed
from rig.live.session import _viewer, viewer_feed
from rig.records.files import read_lines
from rig.records.reading import recorded_values
from rig.records.recorder import FUSED_TOPIC
from rig.tactile.estimator import choose_estimator
from rig.trial import run_trial

pytest.importorskip("rerun", reason="the live view's library is not installed: extra 'live'")


def one_lift(folder: Path, live: LiveFeed) -> None:
    settings = TrialSettings(load_bench("fake"), 0, choose_estimator("pca"))
    run_trial(folder, settings, ["t2"], lifts=1, live=live)


@pytest.fixture(scope="module")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unseen") / "s"
    one_lift(folder, LiveFeed())
    return folder


def same(one: Path, other: Path) -> bool:
    names = ("lifts.jsonl", "lifts.csv", "lifts/001.mcap")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


def test_the_file_opens_in_rerun_with_pictures_markers_arm_and_the_whole_curves(
    unseen: Path, tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    file = tmp_path / "lift.rrd"
    with viewer_feed(file) as feed:
        one_lift(tmp_path / "s", feed)
    assert same(tmp_path / "s", unseen)
    reader = RrdReader(file)
    assert [entry.application_id for entry in reader.recordings()] == ["slip_rig"]
    rows: dict[str, int] = {}
    for chunk in reader.stream().to_chunks():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    pictures = {"/camera", "/tactile/SIM-D0001", "/tactile/SIM-D0002"}
    assert pictures | {"/camera/markers", "/arm/tcp", "/events", "/angle/estimate"} <= set(rows)
    stored = recorded_values(unseen / "lifts/001.mcap", FUSED_TOPIC)
    answered = sum(value["angle_deg"] is not None for value in stored)
    # one row more says how the curve is drawn; a message may be lost, ten figures at a time
    assert answered // 2 < rows["/angle/estimate"] <= answered + 1
    row = read_lines(unseen / "lifts.jsonl")[0]
    assert rows["/camera"] <= row["frames"]["camera"]


def test_a_killed_viewer_changes_nothing(
    unseen: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "lift.rrd"
    address = str(tmp_path / "viewer")
    with _viewer(address, file) as process:
        size = file.stat().st_size

        def kill_in_mid_lift() -> None:
            while file.stat().st_size <= size + 10_000:
                time.sleep(0.01)
            process.kill()

        killer = threading.Thread(target=kill_in_mid_lift, daemon=True)
        killer.start()
        one_lift(tmp_path / "s", LiveFeed((Listener(address, pictures=True),)))
        killer.join(timeout=10.0)
        assert process.wait(10.0) != 0
    assert "ended before the lifts" in caplog.text
    assert same(tmp_path / "s", unseen)


@pytest.mark.real_time
@pytest.mark.timeout(300)
def test_looked_at_in_real_time_no_frame_is_lost(tmp_path: Path, unhurried_bench: BenchConfig) -> None:
    with viewer_feed(tmp_path / "lift.rrd") as feed:
        report = measure_wire(tmp_path / "s", "t1", seeds=1, live=feed, bench=unhurried_bench)
    assert report.complete, report.streams
    assert (tmp_path / "lift.rrd").stat().st_size > 100_000
