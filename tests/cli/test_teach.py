"""`rig teach`: positions are found at the bench, checked, shown, and written; comments stay."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.config.objects import parse_object
from support.command_line import answer, rig, succeed

LEVER = """# of the lab
id = "lever"
name = "my lever"
orientations_deg = [0.0, 20.0]
grip_mm = [1.87, 3.11]

[[position]]
name = "end"
offset_m = -0.05   # measured by eye
width_m = 0.08     # guessed
surface = "edge"
"""


@pytest.fixture
def lab(tmp_path: Path, light_bench_file: Path) -> Path:
    shutil.copy(light_bench_file, tmp_path / "bench.toml")
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "lever.toml").write_text(LEVER)
    return tmp_path


@pytest.mark.heavy
def test_taught_position_is_written_and_can_be_lifted(lab: Path) -> None:
    file = lab / "objects" / "lever.toml"
    taught = answer("teach", "lever", "--bench", lab / "bench.toml", "--yes")
    assert (taught["file"], taught["written"], taught["simulated"]) == (str(file), ["end"], True)
    (found,) = taught["positions"]
    assert found["offset_m"] == pytest.approx(-0.05, abs=0.005)
    assert found["width_m"] == pytest.approx(0.08, abs=0.003)
    assert found["lift_height_m"] == pytest.approx(0.05, abs=0.005)
    place = parse_object(file.read_text(), "").position[0]
    assert place.offset_m == found["offset_m"]
    assert place.width_m == found["width_m"]
    assert "# measured by eye" in file.read_text()
    plan = answer("trial", "--object", "lever", "--lifts", 1, "--bench", lab / "bench.toml", "--dry-run")
    assert any("lever/1" in line for line in plan["plan"])


@pytest.mark.heavy
def test_keys_teach_a_new_position(lab: Path) -> None:
    what = ("teach", "my lever", "--by", "keys", "--position", "middle", "--lift-height", 0.03)
    with (lab / "objects" / "lever.toml").open("a") as stream:
        stream.write('\n[[position]]\nname = "middle"\noffset_m = 0.0\nwidth_m = 0.085\nsurface = "flat"\n')
    succeed(*what, "--bench", lab / "bench.toml", "--yes", "--json")
    places = parse_object((lab / "objects" / "lever.toml").read_text(), "").position
    assert [place.name for place in places] == ["end", "middle"]
    assert places[1].lift_height_m == 0.03
    assert places[0].width_m == 0.08, "the other one is as it was"


@pytest.mark.heavy
def test_position_that_a_trial_would_reject_is_not_written(lab: Path) -> None:
    text = (lab / "bench.toml").read_text()
    box = '\n[[keep_out]]\nname = "shelf"\nmin_m = [0.2, -0.3, 0.28]\nmax_m = [0.7, 0.3, 0.45]\n'
    what = ("teach", "lever", "--bench", lab / "bench.toml", "--yes", "--json")
    (lab / "bench.toml").write_text(text.replace("[arm]", "[arm]", 1) + box)
    done = rig(*what, "--lift-height", 0.25)
    assert done.returncode in (1, 2)
    assert "shelf" in done.stderr
    assert (lab / "objects" / "lever.toml").read_text() == LEVER


@pytest.mark.heavy
def test_dry_run_refusals_and_missing_agreement_leave_the_file_unchanged(lab: Path) -> None:
    what = ("--bench", lab / "bench.toml")
    for options, code, words in (
        (("lever",), 3, ("was not changed",)),
        (("wrench",), 2, ("an object of the package", "rig objects new")),
        (("nothing",), 2, ("your objects: lever", "rig objects new")),
        (("lever", "--dry-run"), 0, ("At each of end: the fingers open wide; you lead the arm", "home")),
    ):
        done = rig("teach", *options, *what)
        assert done.returncode == code
        assert all(word in done.stdout + done.stderr for word in words), options
    assert (lab / "objects" / "lever.toml").read_text() == LEVER


ASKED = """
from rig.terminal.questions import press, show_question
import time
print(press("press:"), press(""), flush=True)
with show_question("there?") as answered:
    while not answered():
        time.sleep(0.01)
print("answered", flush=True)
with show_question("again?") as answered:
    while not answered():
        time.sleep(0.01)
"""


def test_keys_and_enter_are_read_at_a_terminal(at_terminal: Callable[[list[str], int], Any]) -> None:
    terminal = at_terminal([sys.executable, "-c", ASKED], 80)
    terminal.wait_for("press:")
    terminal.read_for(0.3)
    terminal.type("Z")
    terminal.read_for(0.3)
    terminal.type("\r")
    terminal.wait_for("Z enter")
    terminal.wait_for("there?")
    terminal.read_for(0.2)
    terminal.type("\r")
    terminal.wait_for("answered")
    terminal.wait_for("again?")
    terminal.read_for(0.2)
    terminal.type("q\r")
    terminal.wait_for("holds its position")
