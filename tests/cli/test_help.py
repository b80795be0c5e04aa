"""Help of every command, groups of commands, misspelt names, and completion by Tab."""

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from typer.core import TyperGroup

from rig.calibrate.kinds import KINDS
from rig.cli.calibrate import SUMMARIES
from support.command_line import refusal
from support.documentation import commands, program
from support.marks import heavy

STORED_TRIAL = str(Path(__file__).parents[1] / "data" / "stored_trial")
FRAME = "╭╮╰╯─│"


def every_command() -> Iterator[tuple[str, Any]]:
    """Every command and every group of commands, by its name."""
    root = program()
    assert isinstance(root, TyperGroup)
    yield "", root
    imported = ((name, root.get_command(None, name)) for name in root.commands)
    yield from ((name, each) for name, each in imported if isinstance(each, TyperGroup))
    yield from commands().items()


EVERY = dict(every_command())


def help_of(name: str) -> str:
    out = io.StringIO()
    with redirect_stdout(out):
        EVERY[name].main(["--help"], prog_name=f"rig {name}".strip(), standalone_mode=False)
    return out.getvalue()


def words(text: str) -> set[str]:
    return set(text.translate(dict.fromkeys(map(ord, FRAME), " ")).split())


def stated(command: Any) -> Iterator[str]:
    """The texts that the help of a command has to contain."""
    yield command.help
    for param in command.params:
        yield param.help or ""
        yield " ".join(option for option in param.opts if option.startswith("-"))
    for inner in getattr(command, "commands", {}).values():
        yield inner.help.split("\n\n")[0]


@pytest.mark.parametrize("name", program().commands)
def test_summary_in_the_list_of_commands_is_the_first_paragraph_of_the_help(name: str) -> None:
    assert program().commands[name].help == " ".join(EVERY[name].help.split("\n\n")[0].split())


def test_summary_of_a_calibration_is_the_first_paragraph_of_its_help() -> None:
    first = {name: kind.options.__doc__.split("\n\n")[0] for name, kind in KINDS.items()}
    assert {name: " ".join(text.split()) for name, text in first.items()} == SUMMARIES


@pytest.mark.parametrize("columns", [80, pytest.param(140, marks=pytest.mark.heavy)])
@pytest.mark.parametrize("name", EVERY)
def test_help_neither_cuts_nor_splits_a_word(
    name: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    shown = help_of(name)
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= columns
    assert name not in commands() or ("Examples" in shown and f"rig {name}" in shown)
    expected = {word for text in stated(EVERY[name]) for word in text.replace("\\[", "[").split()}
    assert expected - words(shown) == set()


def test_main_help_lists_every_command_in_a_group() -> None:
    shown = help_of("")
    titles = [line.split("─ ")[1].split(" ─")[0] for line in shown.splitlines() if line.startswith("╭")]
    assert titles == ["Options", "Run", "Results", "Own images", "Bench", "Advanced", "Calibrate"]
    assert set(EVERY[""].commands) <= words(shown)


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (("trial", "--estimator", "elipse"), "ellipse"),
        (("trial", "--bench", "hrd"), "hard"),
        (("record", "--object", "wrnch", "--dry-run"), "wrench"),
        (("trial", "--react", "tigthen"), "tighten"),
        (("export", "nowhere", "--to", "parket", "--out", "new"), "parquet"),
        (("benchmark", "estimatrs"), "estimators"),
        (("trail",), "trial"),
        (("explain", STORED_TRIAL, "--serial", "SIM-D001", "--out", "x.png"), "SIM-D0001"),
    ],
)
def test_misspelt_name_is_rejected_with_the_closest_match(
    arguments: tuple[str, ...], near: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert f"id you mean '{near}'" in " ".join(refusal(*arguments).split())


def completed(line: str, folder: Path, code: str = "") -> list[str]:
    """The words that bash offers for the last word of a command line."""
    environment = {
        **os.environ, "_RIG_COMPLETE": "complete_bash", "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }  # fmt: skip
    start = "import sys; sys.argv = ['rig']; from rig.cli.main import main\ntry: main()\nfinally: "
    command = [sys.executable, "-c", start + (code or "pass")]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.split("\n")[:-1]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("rig benchmark est", ["estimators"]),
        ("rig tri", ["trial"]),
        *heavy(("rig trial --react ti", ["tighten"]), ("rig trial --obj", ["--object", "--objects"])),
    ],
)
def test_tab_completes_commands_options_and_choices(line: str, offered: list[str], tmp_path: Path) -> None:
    assert completed(line, tmp_path) == offered


def test_completion_imports_no_slow_modules(tmp_path: Path) -> None:
    *_, loaded = completed("rig trial --obj", tmp_path, "print(*sys.modules)")
    assert not {"numpy", "cv2", "pydantic", "rich", "numba"} & set(loaded.split())
