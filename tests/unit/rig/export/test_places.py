"""An export writes into its own new folder and nowhere else."""

import json
import re
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


def edited(rows: str, key: str, value: str) -> str:
    """Give a value to a key of every row, or of its images where they have it."""
    changed = [json.loads(line) for line in rows.splitlines()]
    for row in changed:
        for part in (row, *row.get("images", ())):
            if key in part:
                part[key] = json.loads(f'"{value}"')
    return "".join(json.dumps(row) + "\n" for row in changed)


@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("trial", "object"),
        ("trial", "name"),
        ("trial", "recording"),
        ("record", "file"),
        ("record", "serial"),
    ],
)
def test_names_in_a_session_cannot_leave_the_export_folder(
    drawn_trial: Drawn, drawn_recording: Drawn, tmp_path: Path, kind: str, key: str
) -> None:
    trial, folder = kind == "trial", tmp_path / "s"
    session = drawn_trial(folder, (12.0,)) if trial else drawn_recording(folder)
    file = session / ("lifts.jsonl" if trial else "poses.jsonl")
    rows, formats = file.read_text(), FORMATS if trial else ["labelme"]
    before = set(tmp_path.rglob("*"))
    said = f"line 1 is damaged: '{'' if trial else 'images.0.'}{key}'"
    for place in OUTSIDE:
        file.write_text(edited(rows, key, place))
        for to in formats:
            with pytest.raises(SessionError, match=re.escape(said)):
                export_session(session, to, tmp_path / "deep" / "er" / "out")
        assert set(tmp_path.rglob("*")) == before


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
