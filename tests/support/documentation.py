"""README and the pages of docs, and the command lines in them."""

import importlib.util
import re
import shlex
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from typer.core import TyperGroup

from rig.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
USAGE_ERROR = typer.BadParameter.__bases__[0]
_FENCE = re.compile(r"^```(?P<language>\w*)$.*?^```$", re.DOTALL | re.MULTILINE)
_SPAN = re.compile(r"`(rig(?: [^`]+)?)`")


def script(name: str) -> ModuleType:
    """Load a script of docs, which is no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def without_code(page: Path) -> str:
    """A page's text without its fenced blocks."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def code_lines(page: Path) -> list[str]:
    """Lines that begin with `rig` in blocks of code, fenced as sh or indented."""
    text = page.read_text(encoding="utf-8")
    fenced = [m.group() for m in _FENCE.finditer(text) if m["language"] == "sh"]
    indented = re.findall(r"^ {4}(?:\$ )?rig .*$", without_code(page), re.MULTILINE)
    lines = [line for block in fenced for line in re.sub(r"\\\n\s*", "", block).splitlines()]
    typed = [re.split(r" (?:\||>|&&) ", line)[0].strip() for line in (*lines, *indented)]
    return [line for line in typed if re.match(r"(?:\$ )?rig ", line)]


def spans(page: Path) -> list[str]:
    """Return the texts between backticks that begin with `rig`."""
    return [" ".join(span.split()) for span in _SPAN.findall(without_code(page))]


@cache
def program() -> Any:
    """Return the command line's parser."""
    return typer.main.get_command(app)


def parse(line: str, may_be_a_name: bool = False) -> str:
    """Parse a command line to its last option, running nothing; return its command, as `fakes serve`.

    may_be_a_name: accept a command's name without its required arguments, as in running text. Raises
    `USAGE_ERROR` for lines that the program rejects.
    """
    words, command, context = shlex.split(line, comments=True)[1:], program(), None
    names: list[str] = []
    while isinstance(command, TyperGroup) and words:
        context = command.make_context(command.name, words, parent=context)
        if command.invoke_without_command and not [*context._protected_args, *context.args]:
            return " ".join(names)  # its options are parsed, and it needs no command
        name, command, words = command.resolve_command(context, [*context._protected_args, *context.args])
        names.append(str(name))
    if words or not may_be_a_name:
        command.make_context(names[-1], words, parent=context)
    return " ".join(names)


@cache
def commands() -> dict[str, Any]:
    """Every command of the program by its name, as `fakes serve`."""

    def below(command: Any, name: str) -> dict[str, Any]:
        if not isinstance(command, TyperGroup):
            return {name: command}
        found: dict[str, Any] = {}
        for word in command.commands:
            inner = command.get_command(None, word)  # type: ignore[arg-type]  # imports a benchmark's study
            found |= below(inner, f"{name} {word}".strip())
        return found

    return below(program(), "")
