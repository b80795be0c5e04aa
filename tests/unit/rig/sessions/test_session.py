"""The session folder: what is finished stays, whatever happens."""

import json
import os
from pathlib import Path

import pytest

from drivers.errors import InputError, RecordingError, SessionError
from rig.sessions.files import append_line, read_lines, write_file
from rig.sessions.layout import MANIFEST
from rig.sessions.session import Session, open_session, read_manifest

REQUEST = {"kind": "trial", "seed": 0}


def start(folder: Path, resume: bool = False, **changes: object) -> Session:
    return open_session(folder, {**REQUEST, **changes}, "lifts.jsonl", resume)


def test_results_are_on_disk_as_they_come_and_found_again(tmp_path: Path) -> None:
    with start(tmp_path / "s") as session:
        session.add({"number": 1}, {"wall_s": 0.1})
        assert read_lines(tmp_path / "s" / "lifts.jsonl") == [{"number": 1}]
    with start(tmp_path / "s", resume=True) as again:
        assert again.rows == [{"number": 1}]
        assert not again.complete


def test_a_line_torn_by_a_crash_is_dropped_and_appending_goes_on(tmp_path: Path) -> None:
    with start(tmp_path / "s") as session:
        session.add({"number": 1}, {})
    with (tmp_path / "s" / "lifts.jsonl").open("ab") as stream:
        stream.write(b'{"number": 2, "na')
    with start(tmp_path / "s", resume=True) as again:
        again.add({"number": 3}, {})
    assert [row["number"] for row in read_lines(tmp_path / "s" / "lifts.jsonl")] == [1, 3]


def test_a_damaged_line_before_the_end_is_named(tmp_path: Path) -> None:
    with start(tmp_path / "s"):
        (tmp_path / "s" / "lifts.jsonl").write_text('{"number": 1}\nrubbish\n{"number": 3}\n')
    with pytest.raises(SessionError, match="line 2"):
        start(tmp_path / "s", resume=True)


def test_a_taken_folder_and_another_request_are_refused(tmp_path: Path) -> None:
    start(tmp_path / "s").close()
    with pytest.raises(InputError, match="--resume"):
        start(tmp_path / "s")
    with pytest.raises(InputError, match="another seed"):
        start(tmp_path / "s", resume=True, seed=1)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not empty"):
        start(tmp_path / "other")


def test_two_writers_at_once_are_refused_and_a_lock_left_behind_is_not_in_the_way(tmp_path: Path) -> None:
    first = start(tmp_path / "s")
    with pytest.raises(RecordingError, match="another rig process"):
        start(tmp_path / "s", resume=True)
    first.close()
    assert (tmp_path / "s" / ".lock").exists()
    start(tmp_path / "s", resume=True).close()


def test_finishing_puts_results_in_order_and_marks_the_target(tmp_path: Path) -> None:
    with start(tmp_path / "s") as session:
        for number in (2, 1, 3):
            session.add({"number": number, "attempt": 0}, {})
        session.finish(order=("number", "attempt"))
    assert [row["number"] for row in read_lines(tmp_path / "s" / "lifts.jsonl")] == [1, 2, 3]
    assert read_manifest(tmp_path / "s")["status"] == "complete"


def test_another_schema_is_refused(tmp_path: Path) -> None:
    start(tmp_path / "s").close()
    path = tmp_path / "s" / MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema_version": 99}))
    with pytest.raises(SessionError, match="99"):
        read_manifest(tmp_path / "s")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_full_disk_is_a_typed_error(tmp_path: Path) -> None:
    full = tmp_path / "full.jsonl"
    full.symlink_to("/dev/full")
    with pytest.raises(RecordingError, match="free space"):
        append_line(full, {"number": 1})


def test_a_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "kept.json"
    write_file(path, b"old")

    def no_space(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(RecordingError, match="No space left"):
        write_file(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
