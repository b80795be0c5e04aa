"""Groups and commands of `rig`: options from dataclasses, and messages about misspelt names."""

import re
from collections.abc import Callable
from inspect import cleandoc
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from drivers.errors import nearest
from rig.declared import with_options
from rig.terminal.screen import begin_phase

SIMULATED_BENCHES = ("fake", "hard", "wire")
"""The built-in benches."""


class Commands(typer.Typer):
    """A group of commands whose options may be declared in dataclasses."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"cls": Group, **settings})

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        """Register a function as a command."""
        register = super().command(name, cls=Command, **settings)
        return lambda declared: register(_with_whole_paragraphs(with_options(declared)))


class _NamesNearest:
    """Mixin that names the most similar choice in the message about an invalid one."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options and arguments; a group parses them up to the name of the command."""
        if ctx.resilient_parsing:  # completion: the validation of values imports slow modules
            for param in self.get_params(ctx):  # pyright: ignore[reportAttributeAccessIssue]
                param.process_value = lambda _, value: value
        try:
            return super().parse_args(ctx, args)  # pyright: ignore[reportAttributeAccessIssue]
        except typer.BadParameter as error:
            error.message = _with_nearest_choice(error.message)
            raise


class Command(_NamesNearest, TyperCommand):
    """A command of the rig."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options; if the bench is simulated, show that from now on while loading."""
        rest = super().parse_args(ctx, args)
        bench = ctx.params.get("bench")
        if bench in SIMULATED_BENCHES and not (ctx.resilient_parsing or ctx.params.get("source")):
            begin_phase(f"SIMULATED bench '{bench}': loading")
        return rest


class Group(_NamesNearest, TyperGroup):
    """A group of commands of the rig. listing: while the help lists commands, which need no import for it."""

    listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        self.listing = True
        super().format_help(ctx, formatter)
        self.listing = False


def _with_whole_paragraphs(function: Callable[..., Any]) -> Callable[..., Any]:
    """Join the lines of each paragraph of the docstring, so that typer wraps them to the terminal's width."""
    function.__doc__ = re.sub(r"(?<!\n)\n(?![\n ])", " ", cleandoc(function.__doc__ or ""))
    return function


def _with_nearest_choice(message: str) -> str:
    """Add the most similar choice to the message about an invalid choice."""
    wrong = re.search("'(.*)' is not one of (.*)[.]", message)
    if wrong is None:
        return message
    near = nearest(wrong[1], re.findall("'(.*?)'", wrong[2]))
    return f"{wrong[0][:-1]}{near}."
