"""`rig benchmark others`: missing clients and readers are skipped, the others are judged."""

from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.benchmark.harness import Run
from rig.benchmark.others.clients import Row, commit_of, skipped
from rig.benchmark.others.study import OthersOptions, measure, others_table


def test_missing_clients_and_readers_are_skipped_with_how_to_get_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rig.benchmark.others.clients.installed", lambda package: None)
    rows = measure(OthersOptions(), Run()).tables[0].records
    assert [row.met for row in rows] == [None] * 5
    results = [row.result for row in rows]
    assert results[0] == "skipped: pip install ur-rtde"
    assert "git clone https://github.com/UniversalRobots/RTDE_Python_Client_Library" in results[1]
    assert "--session" in results[-1]


def test_unknown_part_is_rejected() -> None:
    with pytest.raises(
        InputError, match=r"part 'clints' \(did you mean 'clients'\?\): choose one of clients"
    ):
        measure(OthersOptions(["clints"]), Run())


def test_table_marks_unexpected_results() -> None:
    rows = [Row("a", "b | c", "1", "x", False), skipped("a", "d", "pip install d")]
    table = others_table(rows)
    assert [row[-1] for row in table.rows] == ["NO", ""]
    assert "| a | b / c | 1 | x | NO |" in table.markdown()


def test_clone_without_git_folder_has_an_unknown_commit(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == "unknown"
    assert commit_of(tmp_path / "missing") is None
