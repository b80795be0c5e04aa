"""Groups and commands of `rig`: options from dataclasses, and messages about misspelt names."""

import re
import sys
from collections.abc import Callable
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from drivers.errors import FormatError, nearest
from drivers.formats import read_json
from rig.declared import is_given, with_options
from rig.terminal.screen import begin_phase

SIMULATED_BENCHES = ("fake", "hard", "wire")
"""The built-in benches."""


class Commands(typer.Typer):
    """A group of commands whose options may be declared in dataclasses."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"cls": Group, **settings})

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        register = super().command(name, cls=Command, **settings)

        def register_command(declared: Any) -> Any:
            function = with_options(declared)
            # Lines of a paragraph are joined, so that typer wraps them to the width of the terminal.
            # Examples, which are indented, become paragraphs, so that it does not join them.
            text = re.sub(r"(?<!\n)\n(?![\n ])", " ", cleandoc(function.__doc__ or ""))
            function.__doc__ = re.sub(r"(\n  \S.*)(?=\n  \S)", r"\1\n", text)
            return register(function)

        return register_command


class _NamesNearest:
    """Mixin that names the most similar choice in the message about an invalid one."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if ctx.resilient_parsing:  # completion: the validation of values imports slow modules
            for param in self.get_params(ctx):  # pyright: ignore[reportAttributeAccessIssue]
                param.process_value = lambda _, value: value
        try:
            return super().parse_args(ctx, args)  # pyright: ignore[reportAttributeAccessIssue]
        except typer.BadParameter as error:
            if wrong := re.search("'(.*)' is not one of (.*)[.]", error.message):
                near = nearest(wrong[1], re.findall("'(.*?)'", wrong[2]))
                error.message = f"{wrong[0][:-1]}{near}."
            raise


class Command(_NamesNearest, TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options; if the bench is simulated, show that from now on while loading."""
        rest = super().parse_args(ctx, args)
        bench, session = ctx.params.get("bench"), ctx.params.get("out")
        if ctx.resilient_parsing or ctx.params.get("source"):
            return rest
        if ctx.params.get("resume") and session and not is_given(ctx, "bench"):
            if name := _stored_bench(session):
                begin_phase(f"{name} as stored in {session}: loading")
        elif bench in SIMULATED_BENCHES:
            begin_phase(f"SIMULATED bench '{bench}': loading")
        return rest

    def format_help(self, ctx: Any, formatter: Any) -> None:
        _import_layout()
        super().format_help(ctx, formatter)


def _stored_bench(session: Path) -> str:
    """Return the name of a session's bench, with its mark if simulated; "" if it is unknown.

    The session is read and checked later: this takes no time.
    """
    try:
        manifest = read_json(session / "session.json")
        return f"{'SIMULATED ' if manifest['simulated'] else ''}bench '{manifest['bench']}'"
    except (OSError, FormatError, ValueError, KeyError, TypeError):
        return ""


class Group(_NamesNearest, TyperGroup):
    """A group of commands of the rig. Commands that are announced are imported when they are used."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self._loaders: dict[str, Callable[[], Any]] = {}
        self._listing = False

    def announce(self, name: str, summary: str, load: Callable[[], Any], panel: str | None = None) -> None:
        """Add a command that lists and completion show without importing it. load: imports and returns it."""
        self.commands[name] = TyperCommand(name, help=summary, rich_help_panel=panel)
        self._loaders[name] = load

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if self._listing or cmd_name not in self._loaders:
            return super().get_command(ctx, cmd_name)
        return self._loaders[cmd_name]()

    def format_help(self, ctx: Any, formatter: Any) -> None:
        _import_layout()
        self._listing = True
        super().format_help(ctx, formatter)
        self._listing = False

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        self._listing = True
        return super().shell_complete(ctx, incomplete)


def as_command(name: str, declared: Any) -> Any:
    """Return a command for a group. declared: its function, or a `Commands` of subcommands."""
    alone = Commands(add_completion=False)
    if isinstance(declared, Commands):
        alone.add_typer(declared, name=name)
    else:
        alone.command(name)(declared)
    alone.callback()(_no_options)  # keeps typer from making the only command the program
    return get_command(alone).commands[name]  # pyright: ignore[reportAttributeAccessIssue]


def _no_options() -> None:
    pass


def _import_layout() -> None:
    """Import typer's layout of help without Markdown and tracebacks, a quarter of the time of `rig --help`.

    The layout uses them only for Markdown help and for errors of Python, which the rig prints itself.
    """
    unused = ("rich.markdown", "rich.traceback")
    if any(name in sys.modules for name in (*unused, "typer.rich_utils")):
        return
    for name in unused:
        stand_in: Any = ModuleType(name)
        stand_in.__getattr__ = lambda _: None
        sys.modules[name] = stand_in
    try:
        import_module("typer.rich_utils")
    finally:
        for name in unused:
            del sys.modules[name]
