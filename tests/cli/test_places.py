"""Every output path of a command is checked before any work."""

from pathlib import Path

import pytest

from support.command_line import rig

FILES = (
    ("compare", "a", "b", "--out"), ("report", "s", "--out"), ("play", "s", "--lift", "1", "--out"),
    ("calibrate", "board", "--out"), ("model", "import", "x.pth", "--out"), ("fakes", "serve", "--write"),
    ("benchmark", "clips", "c", "--readme"), ("benchmark", "safety", "--readme"),
    ("benchmark", "estimators", "--readme"),
)  # fmt: skip
FOLDERS = (
    ("replay", "s", "--out"), ("export", "s", "--to", "csv", "--out"), ("doctor", "--snapshot"),
    ("segment", "x.png", "--out"), ("label", "x.png", "--out"), ("train", "--out"),
    ("calibrate", "camera", "--out"), ("calibrate", "tcp", "--out"),
    ("benchmark", "clips", "c", "--out"), ("benchmark", "estimators", "--out"),
    ("benchmark", "segmentation", "--out"), ("benchmark", "trials", "--out"), ("benchmark", "wire", "--out"),
    ("benchmark", "safety", "--out"), ("benchmark", "lifts", "--out"),
)  # fmt: skip


@pytest.fixture(autouse=True)
def _no_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


def refused(command: tuple[object, ...], *words: str) -> None:
    done = rig(*command)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 2, done.stderr
    assert last.startswith("rig: ")
    for word in words:
        assert word in last, last
    assert len([line for line in done.stderr.splitlines() if not line.startswith("calibration in use")]) == 1


@pytest.mark.parametrize("command", FILES, ids=" ".join)
def test_output_file_in_a_missing_folder_is_rejected_first(command: tuple[str, ...], tmp_path: Path) -> None:
    refused((*command, tmp_path / "missing" / "x.html"), "does not exist", "missing")


@pytest.mark.parametrize("command", FOLDERS, ids=" ".join)
def test_output_folder_that_is_a_file_is_rejected_first(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "there").write_text("")
    refused((*command, tmp_path / "there" / "x"), "there is a file")


def test_output_file_that_is_a_folder_is_rejected(tmp_path: Path) -> None:
    refused(("report", "s", "--out", tmp_path), "is a folder")
