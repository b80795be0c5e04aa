"""An export writes into its own new folder and nowhere else."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import InputError, SessionError
from rig.config import load_bench
from rig.config.load import parse_bench
from rig.config.write import bench_text
from rig.export.formats import FORMATS, export_session

Drawn = Callable[..., Path]
OUTSIDE = ("../../out", "..", "/out", "a/../../out", "a//b", ".", "", "a\\u0000b", "a\\nb")


def edited(session: Path, file: str, key: str, value: str) -> None:
    """Give a value to a key of every row, or of its images where they have it."""
    rows = [json.loads(line) for line in (session / file).read_text().splitlines()]
    for row in rows:
        for part in (row, *row.get("images", ())):
            if key in part:
                part[key] = json.loads(f'"{value}"')
    (session / file).write_text("".join(json.dumps(row) + "\n" for row in rows))


def everything(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


@pytest.mark.parametrize("place", OUTSIDE)
@pytest.mark.parametrize("key", ["object", "name", "recording"])
def test_names_in_a_trial_cannot_leave_the_export_folder(
    drawn_trial: Drawn, tmp_path: Path, key: str, place: str
) -> None:
    session = drawn_trial(tmp_path / "s", (12.0,))
    edited(session, "lifts.jsonl", key, place)
    before = everything(tmp_path)
    for to in FORMATS:
        with pytest.raises(SessionError, match=rf"line 1 is damaged: '{key}'"):
            export_session(session, to, tmp_path / "deep" / "er" / "out")
    assert everything(tmp_path) == before


@pytest.mark.parametrize("place", OUTSIDE)
@pytest.mark.parametrize("key", ["file", "serial"])
def test_names_in_a_recording_cannot_leave_the_export_folder(
    drawn_recording: Drawn, tmp_path: Path, key: str, place: str
) -> None:
    session = drawn_recording(tmp_path / "s")
    edited(session, "poses.jsonl", key, place)
    before = everything(tmp_path)
    with pytest.raises(SessionError, match=rf"line 1 is damaged: 'images\.0\.{key}'"):
        export_session(session, "labelme", tmp_path / "deep" / "er" / "out")
    assert everything(tmp_path) == before


@pytest.mark.parametrize("place", ["../x", "/x", "a/b", ".."])
def test_serials_and_bench_names_are_valid_file_names(place: str) -> None:
    text = bench_text(load_bench("fake"))
    for old in ("SIM-D0001", "SIM-C0001", "fake"):
        with pytest.raises(InputError, match=r"is not a (name of a file|valid file name)"):
            parse_bench(text.replace(f'"{old}"', f'"{place}"', 1), "bench.toml")


def test_existing_part_folder_of_a_user_is_kept(drawn_trial: Drawn, tmp_path: Path) -> None:
    session = drawn_trial(tmp_path / "s", (12.0,))
    mine = tmp_path / "out.part"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    export_session(session, "csv", tmp_path / "out")
    assert (mine / "thesis.tex").read_text() == "years of work"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.part", "s"]
    assert (tmp_path / "out").stat().st_mode == mine.stat().st_mode
