"""Command lines in README and docs parse, with their options, as the program itself parses them."""

import re
import shlex
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

from rig.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
USAGE_ERROR = typer.BadParameter.__bases__[0]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def command_lines(page: Path) -> list[str]:
    """Lines that begin with `rig` in blocks of code, comments left out."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return [line.strip() for line in lines if re.match(r"(?:    |\$ )rig ", line)]


def parse(line: str) -> str:
    """Parse a command line to its last option, running nothing; return its last command's name."""
    words, command, context = shlex.split(line, comments=True)[1:], typer.main.get_command(app), None
    while isinstance(command, TyperGroup):
        context = command.make_context(command.name, words, parent=context)
        _, command, words = command.resolve_command(context, [*context._protected_args, *context.args])
    assert command is not None
    return str(command.make_context(command.name, words, parent=context).command.name)


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_every_command_line_parses(page: Path) -> None:
    lines = command_lines(page)
    assert lines, "no command line is found: has the way they are written changed?"
    for line in lines:
        try:
            assert parse(line) in line
        except USAGE_ERROR as error:
            pytest.fail(f"{page.name}: {line}: {error}")


@pytest.mark.parametrize(
    "line", ["rig label-angle", "rig label-angle a --nope", "rig estimat x", "rig bench new"]
)
def test_a_wrong_one_would_be_seen(line: str) -> None:
    with pytest.raises(USAGE_ERROR):
        parse(line)
