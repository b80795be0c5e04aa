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
        register = super().command(name, cls=Command, **settings)

        def registered(declared: Any) -> Any:
            function = with_options(declared)
            # Lines of a paragraph are joined, so that typer wraps them to the width of the terminal.
            # Examples, which are indented, become paragraphs, so that it does not join them.
            text = re.sub(r"(?<!\n)\n(?![\n ])", " ", cleandoc(function.__doc__ or ""))
            function.__doc__ = re.sub(r"(\n  \S.*)(?=\n  \S)", r"\1\n", text)
            return register(function)

        return registered


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
        bench = ctx.params.get("bench")
        if bench in SIMULATED_BENCHES and not (ctx.resilient_parsing or ctx.params.get("source")):
            begin_phase(f"SIMULATED bench '{bench}': loading")
        return rest


class Group(_NamesNearest, TyperGroup):
    """A group of commands of the rig. listing: while the help lists commands, which need no import for it."""

    listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self.listing = True
        super().format_help(ctx, formatter)
        self.listing = False
