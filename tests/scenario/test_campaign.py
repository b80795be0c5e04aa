"""Many sessions: listed, replayed into one table, through kills, damage and a cluster."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import trial_manifest
from rig.results.listing import SessionState, list_session
from rig.results.table import COLUMNS, REPLAYS
from rig.sessions.records import LIFTS
from rig.sessions.rows import read_finished_lifts, read_rows
from rig.sessions.session import open_session
from rig.sessions.table_files import Line, pyarrow_modules
from rig.tactile.estimators import choose_estimator
from support.command_line import answer, refusal, rig, succeed
from support.own_estimators import MODULE, own_estimators
from support.tables import read_typed_csv
from support.waiting import until


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory, two_lifts: Path) -> Path:
    """A good session of two lifts, one with a recording cut short, one without a readable manifest."""
    folder = tmp_path_factory.mktemp("sessions")
    for name in ("a", "c", "d"):
        shutil.copytree(two_lifts, folder / name)
    recording = folder / "c" / "lifts" / "001.mcap"
    recording.write_bytes(recording.read_bytes()[:200_000])
    rows = folder / "c" / "lifts.jsonl"
    rows.write_text(rows.read_text().splitlines(keepends=True)[0])
    (folder / "d" / "session.json").write_text('{"schema_version": 1, "kind"')
    return folder


def command_of(*arguments: str) -> list[str]:
    """Run the command line in a separate process."""
    return [sys.executable, "-m", "rig", *arguments]


def test_a_session_in_use_is_running_and_one_left_is_unfinished(
    tmp_path: Path, light_bench: BenchConfig
) -> None:
    manifest = trial_manifest(TrialSettings(light_bench, 0, choose_estimator("pca")), ["t1"], 3)
    with open_session(tmp_path / "s", manifest, LIFTS, resume=False):
        assert list_session(tmp_path / "s").state is SessionState.RUNNING
    entry = list_session(tmp_path / "s")
    assert (entry.state, entry.done, entry.wanted) == (SessionState.UNFINISHED, 0, 3)


@pytest.mark.heavy
def test_many_sessions_give_one_table_and_the_broken_ones_their_problem(
    sessions: Path, tmp_path: Path
) -> None:
    out = tmp_path / "all"
    done = rig("replay", str(sessions), "--jobs", "1", "--out", str(out), "--json")
    assert done.returncode == 2, done.stderr
    figures = json.loads(done.stdout)
    assert (figures["lifts_accepted"], figures["identical"], figures["simulated"]) == (2, 2, True)
    assert [Path(b["session"]).name for b in figures["broken"]] == ["c", "d"]
    lines = read_typed_csv(out / "results.csv", COLUMNS)
    assert pyarrow_modules()[1].read_table(out / "results.parquet").to_pylist() == lines
    good = [line for line in lines if not line["problem"]]
    stored = read_finished_lifts(sessions / "a")
    assert [line["re_mean_deg"] for line in good[:2]] == [row.re.mean_deg for row in stored if row.re]


def kept_rows(out: Path) -> list[Line]:
    return read_rows(out / "replays.jsonl", REPLAYS)


@pytest.mark.heavy
def test_killed_replay_resumes_after_its_last_lift(sessions: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    command = ["replay", str(sessions / "a"), "--jobs", "1", "--out", str(out), "--resume"]
    process = subprocess.Popen(command_of(*command), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until(lambda: bool(kept_rows(out)))
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=120)
    kept = kept_rows(out)
    assert len(kept) == 1
    figures = answer(*command)
    assert (figures["lifts_accepted"], figures["identical"]) == (2, 2)
    lines = kept_rows(out)
    assert [line for line in lines if line in kept] == kept
    assert len({(line["session"], line["number"]) for line in lines}) == len(lines) == 2
    assert "estimator nothing, not ellipse" in refusal(*command, "--estimator", "ellipse")


@pytest.mark.heavy
def test_a_cluster_of_two_workers_gives_the_same_table(sessions: Path, tmp_path: Path) -> None:
    """Also where the estimator is a lab's own, which the workers import themselves."""
    distributed = pytest.importorskip("distributed")
    what = ("replay", str(sessions / "a"), "--json", "--out")
    mine = ("--estimator", f"{MODULE}:Mine")
    with (
        own_estimators(tmp_path),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
        ) as cluster,
    ):
        engine = ("--engine", cluster.scheduler_address.replace("tcp://", "dask://"))
        there, own = (
            subprocess.run(
                command_of(*what, str(tmp_path / out), *engine, *which),
                capture_output=True, text=True, timeout=200, check=False,
                env={**os.environ, "PYTHONPATH": str(tmp_path)},
            )
            for out, which in (("there", ()), ("own", mine))
        )  # fmt: skip
        assert rig(*what, tmp_path / "own here", *mine, "--jobs", "1").returncode == 0
    assert there.returncode == 0, there.stderr
    assert json.loads(there.stdout)["identical"] == 2
    assert own.returncode == 0, own.stderr
    succeed(*what, tmp_path / "here", "--jobs", "1")
    tables = {
        name: (tmp_path / name / "results.csv").read_text() for name in ("there", "here", "own", "own here")
    }
    assert tables["there"] == tables["here"]
    assert tables["own"] == tables["own here"]
    assert {line["estimator"] for line in read_typed_csv(tmp_path / "own/results.csv", COLUMNS)} == {mine[1]}


def test_unreachable_engine_is_rejected(sessions: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    for engine, words in (("dask://127.0.0.1:1", "no dask scheduler"), ("spark://x:1", "dask://HOST:PORT")):
        done = refusal("replay", str(sessions / "a"), "--engine", engine, "--out", str(tmp_path / "x"))
        assert words in done.splitlines()[-1]
        assert "Traceback" not in done
