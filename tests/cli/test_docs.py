"""The command lines in the documentation are ones that the rig takes."""

import shlex
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from rig.cli.main import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def command_lines() -> list[tuple[str, str]]:
    """Each indented line that begins with `rig`, by its page."""
    lines = [(page.name, line.strip()) for page in PAGES for line in page.read_text().splitlines()]
    return [(page, line.partition("  #")[0]) for page, line in lines if line.startswith("rig ")]


def parsed(command: Any, name: str, arguments: list[str], parent: Any = None) -> None:
    """Parse as the command line does, down to the last subcommand, and run nothing."""
    with command.make_context(name, arguments, parent=parent) as context:
        rest = [*context._protected_args, *context.args]
        if hasattr(command, "resolve_command"):
            name, inner, rest = command.resolve_command(context, rest)
            parsed(inner, name or "", rest, context)


@pytest.mark.parametrize(("page", "line"), command_lines())
def test_a_command_line_of_the_documentation_parses(page: str, line: str) -> None:
    parsed(get_command(app), "rig", shlex.split(line)[1:])


def test_there_are_some_of_each_page() -> None:
    assert {page.name for page in PAGES} >= {"README.md", "safety.md"}
    assert {"safety.md", "README.md"} <= {page for page, _ in command_lines()}


def test_one_that_is_wrong_is_seen() -> None:
    with pytest.raises(Exception, match="o such option"):
        parsed(get_command(app), "rig", ["benchmark", "safety", "--fulll"])
    with pytest.raises(Exception, match="No such command"):
        parsed(get_command(app), "rig", ["benchmark", "safely"])
