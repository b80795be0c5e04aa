"""The session folder keeps finished work under all faults."""

import json
import logging
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import InputError, OperatorStopError, RecordingError
from rig.config import load_bench
from rig.sessions.files import MANIFEST, append_line, write_file
from rig.sessions.manifest import is_session, read_manifest
from rig.sessions.records import LIFTS, Lift, LiftTiming
from rig.sessions.rows import read_lifts
from rig.sessions.session import Session, SessionLog, newest_unfinished, open_session
from support.recordings import trial_request

MakeRow = Callable[..., Lift]
TIMING = LiftTiming(number=1, attempt=0, wall_s=0.1, stages={})


def start(folder: Path, resume: bool = False, seed: int = 0) -> Session[Lift]:
    return open_session(folder, trial_request(seed=seed), LIFTS, resume)


def test_each_result_is_on_disk_at_once_and_an_incomplete_last_line_is_removed(
    tmp_path: Path, lift_row: MakeRow
) -> None:
    with start(tmp_path / "s") as session:
        session.add(lift_row(1), TIMING)
        assert read_lifts(tmp_path / "s") == [lift_row(1)]
    with (tmp_path / "s" / "lifts.jsonl").open("ab") as stream:
        stream.write(b'{"number": 2, "na')
    with start(tmp_path / "s", resume=True) as again:
        assert again.rows == [lift_row(1)]
        assert not again.complete
        again.add(lift_row(3), TIMING)
    assert [row.number for row in read_lifts(tmp_path / "s")] == [1, 3]


def test_folder_in_use_or_with_another_request_is_refused(tmp_path: Path) -> None:
    start(tmp_path / "s").close()
    with pytest.raises(InputError, match="--resume"):
        start(tmp_path / "s")
    with pytest.raises(InputError, match="started with seed 0, not 1"):
        start(tmp_path / "s", resume=True, seed=1)
    bench = load_bench("fake")
    camera = bench.camera.model_copy(update={"focal_px": 700.0})
    other = trial_request(bench.model_copy(update={"camera": camera}))
    with pytest.raises(InputError, match=rf"config\.camera\.focal_px {bench.camera.focal_px}, not 700\.0"):
        open_session(tmp_path / "s", other, LIFTS, resume=True)
    for name in ("other/thesis.tex", "bench/calibrations/camera-SIM-C0001.yaml"):
        file = tmp_path / name
        file.parent.mkdir(parents=True)
        file.write_text("years of work")
        with pytest.raises(InputError, match="not empty"):
            start(tmp_path / name.partition("/")[0])
        assert file.read_text() == "years of work"
    (tmp_path / "bench" / f"{MANIFEST}.part").touch()  # as of a session that was killed when it began
    start(tmp_path / "bench").close()


def test_start_without_any_result_leaves_no_session(tmp_path: Path, lift_row: MakeRow) -> None:
    def stopped(name: str, work: Callable[[Session[Lift]], object], resume: bool = False) -> None:
        with start(tmp_path / name, resume) as session:
            work(session)
            raise OperatorStopError("no")

    for name, work in (
        ("declined", lambda session: None),
        ("reference", lambda session: session.write("reference/T1.png", b"a frame")),
        ("lift", lambda session: session.add(lift_row(1), TIMING)),
    ):
        with pytest.raises(OperatorStopError):
            stopped(name, work)
    assert {path.name for path in tmp_path.iterdir()} == {"reference", "lift"}
    with pytest.raises(OperatorStopError):
        stopped("reference", lambda session: None, resume=True)
    assert is_session(tmp_path / "reference")
    assert read_lifts(tmp_path / "lift") == [lift_row(1)]


def test_newest_unfinished_session_of_a_bench_is_found(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no unfinished trial"):
        newest_unfinished("trial", "fake", tmp_path)
    for name, changes in (
        ("a", {"started": "2026-11-21T09:30:00+00:00"}),
        ("b", {"started": "2026-11-22T09:30:00+00:00"}),
        ("c", {"started": "2026-11-23T09:30:00+00:00", "bench": "another"}),
        ("d", {"started": "2026-11-24T09:30:00+00:00", "status": "complete"}),
    ):
        start(tmp_path / name).close()
        path = tmp_path / name / MANIFEST
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / MANIFEST).write_text("damaged")
    assert newest_unfinished("trial", "fake", tmp_path) == tmp_path / "b"
    with start(tmp_path / "b", resume=True):
        assert newest_unfinished("trial", "fake", tmp_path) == tmp_path / "a"


def test_second_writer_is_refused_and_a_stale_lock_is_ignored(tmp_path: Path) -> None:
    first = start(tmp_path / "s")
    with pytest.raises(RecordingError, match="another rig process"):
        start(tmp_path / "s", resume=True)
    first.close()
    assert (tmp_path / "s" / ".lock").exists()
    start(tmp_path / "s", resume=True).close()


def test_finishing_puts_results_in_order_and_marks_the_target(tmp_path: Path, lift_row: MakeRow) -> None:
    with start(tmp_path / "s") as session:
        for number in (2, 1, 3):
            session.add(lift_row(number), TIMING)
        session.finish(order=lambda row: row.number)
    assert [row.number for row in read_lifts(tmp_path / "s")] == [1, 2, 3]
    assert read_manifest(tmp_path / "s").status == "complete"


def test_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "kept.json"
    write_file(path, b"old")

    def no_space(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(RecordingError, match="No space left"):
        write_file(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_password_of_a_camera_is_not_stored_and_the_session_continues(tmp_path: Path) -> None:
    bench = load_bench("wire")
    secret = "http://me:s3cret@192.0.2.7/video?pwd=s3cret"
    camera = bench.camera.model_copy(update={"address": secret})
    tactile = tuple(t.model_copy(update={"address": secret}) for t in bench.tactile)
    bench = bench.model_copy(update={"camera": camera, "tactile": tactile})
    manifest = trial_request(bench)
    open_session(tmp_path / "s", manifest, LIFTS, resume=False).close()
    assert "s3cret" not in (tmp_path / "s" / MANIFEST).read_text()
    assert "me:***@192.0.2.7" in (tmp_path / "s" / MANIFEST).read_text()
    open_session(tmp_path / "s", manifest, LIFTS, resume=True).close()
    assert bench.camera.address == secret


def test_appended_line_is_on_the_disk_before_the_call_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[bytes] = []
    monkeypatch.setattr("os.fsync", lambda _: synced.append((tmp_path / "lines").read_bytes()))
    append_line(tmp_path / "lines", b"one\n")
    append_line(tmp_path / "lines", b"two\n")
    assert synced == [b"one\n", b"one\ntwo\n"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk_is_a_typed_error_and_reported_once_by_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    full = tmp_path / "full.jsonl"
    full.symlink_to("/dev/full")
    with pytest.raises(RecordingError, match="free space"):
        append_line(full, b"a line\n")
    log = SessionLog("/dev/full")
    for _ in range(3):
        log.emit(logging.LogRecord("rig", logging.INFO, "", 0, "something", None, None))
    log.close()
    _, error = capsys.readouterr()
    assert error.count("\n") == 1
    assert "/dev/full: cannot be written" in error
