"""Format the help of every command: options in groups, lines wrapped to the terminal's width.

Commands of a `Commands` group also complete names with the Tab key (`rig.cli.completing`).
"""

import re
from collections.abc import Callable, Iterator, Sequence
from inspect import cleandoc
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.models import OptionInfo, ParameterInfo

from drivers.errors import nearest
from rig.cli.completing import COMPLETED
from rig.cli.declared import with_options
from rig.live.screen import begin_phase

if TYPE_CHECKING:
    from rich.console import Console

COMMAND_GROUPS = {
    "Run": ("trial", "record", "replay", "teach"),
    "Results": ("sessions", "report", "play", "compare", "results", "export"),
    "Own images": ("live", "bridge", "estimate", "explain", "segment", "label", "label-angle"),
    "Bench": ("doctor", "bench", "objects", "fakes"),
    "Calibrate": ("calibrate",),
    "Advanced": (
        "benchmark",
        "estimators",
        "new",
        "model",
        "train",
        "train-angle",
        "train-turning",
        "fit-slip",
    ),
}
"""Titles of the groups in `rig --help` and their commands, in the order shown."""
OPTION_GROUPS = {
    "Options": (
        "--object", "--lifts", "--poses", "--images", "--from", "--target", "--estimator", "--background",
        "--data", "--arch", "--fold", "--react", "--bench", "--lift", "--sensor", "--out", "--page",
        "--resume", "--full", "--json", "--help",
    ),
    "Estimation": (
        "--window", "--reference-time", "--lift-from", "--timestamps", "--fps", "--pixel-aspect", "--no-skip",
    ),
    "Reaction to slip": ("--false-alarms-per-hour", "--max-turn-deg"),
    "Limits": (
        "--limits", "--max-mare", "--within", "--confidently-wrong", "--two-sigma", "--false-rest",
        "--mean-deg", "--p99-ms",
    ),
    "Session": ("--name", "--note", "--tag", "--operator", "--no-report"),
    "Bench": ("--dry-run", "--yes", "--objects", "--serial", "--seed", "--realtime", "--jobs", "--randomise"),
    "Watch": ("--watch", "--watch-at", "--live"),
}  # fmt: skip
"""Titles of the groups of options and their options; common options first, all others under `REST`."""
REST = "Further options"
FEW = 9
"""Number of options up to which they are shown in one list."""
NAME_COLUMNS = 28
"""Width of the column of names, in characters; a longer name gets a line above its description."""


SIMULATED_BENCHES = ("fake", "hard", "wire")
"""The built-in benches."""

Rows = list[tuple[str, str]]
"""Names and their descriptions."""


class Commands(typer.Typer):
    """A group of commands with the help format and the completion of this module."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"cls": Group, **settings})

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        """Register a function as a command."""
        register = super().command(name, cls=Command, **settings)

        def registered(declared: Any) -> Any:
            function = with_options(declared)
            for parameter, kind in function.__annotations__.items():
                for info in getattr(kind, "__metadata__", ()):
                    if isinstance(info, ParameterInfo):
                        info.autocompletion = info.autocompletion or _completer(parameter, info)
            return register(function)

        return registered


class _Helped:
    """Mixin that replaces the help and the completion of typer's commands and groups."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options and arguments; a group parses them up to the name of the command."""
        _skip_checks_for_completion(self, ctx)
        try:
            return super().parse_args(ctx, args)  # pyright: ignore[reportAttributeAccessIssue]
        except typer.BadParameter as error:
            error.message = _with_nearest_choice(error.message)
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        _print_help(self, ctx)


class Command(_Helped, TyperCommand):
    """A command with the help format of this module."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options; if the bench is simulated, show that from now on while loading."""
        rest = super().parse_args(ctx, args)
        bench = ctx.params.get("bench")
        if bench in SIMULATED_BENCHES and not (ctx.resilient_parsing or ctx.params.get("source")):
            begin_phase(f"SIMULATED bench '{bench}': loading")
        return rest


class Group(_Helped, TyperGroup):
    """A group of commands with the help format of this module."""


def _completer(parameter: str, info: ParameterInfo) -> Callable[..., list[str]] | None:
    """Return the function that completes a parameter of a command; None if it is not completed."""
    if not isinstance(info, OptionInfo):
        return COMPLETED.get(parameter)
    # typer stores the flag as `default` if the option is declared inside Annotated.
    given = info.default if isinstance(info.default, str) else f"--{parameter.replace('_', '-')}"
    return COMPLETED.get(given)


def _skip_checks_for_completion(command: Any, ctx: Any) -> None:
    """Do not validate values during shell completion, because the validation imports pydantic (slow)."""
    if ctx.resilient_parsing:
        for param in command.get_params(ctx):
            param.process_value = lambda _, value: value


def _with_nearest_choice(message: str) -> str:
    """Add the most similar choice to the message about an invalid choice."""
    wrong = re.search("'(.*)' is not one of (.*)[.]", message)
    if wrong is None:
        return message
    near = nearest(wrong[1], re.findall("'(.*?)'", wrong[2]))
    return f"{wrong[0][:-1]}{near}."


def _print_help(command: Any, ctx: Any) -> None:
    from rig.live.console import PlainConsole

    console = PlainConsole(highlight=False)
    console.print(f"\n{command.get_usage(ctx)}", style="bold")
    for line in (*_prose(cleandoc(command.help or ""), console.width), ""):
        console.print(line)
    for title, rows in (*_options(command, ctx).items(), *_commands(command, ctx).items()):
        _print_panel(console, title, rows)


def _prose(text: str, width: int) -> Iterator[str]:
    """Wrap each paragraph to the width; keep the lines of examples, which are indented."""
    listed = False
    for paragraph in text.split("\n\n"):
        heading, *examples = re.split(r"^  ", paragraph, flags=re.MULTILINE)
        if not listed or heading:
            yield ""
        yield from _folded(heading, width)
        for example in examples:
            yield from _folded(example, width, "  ", "    ")
        listed = bool(examples)


def _folded(text: str, width: int, indent: str = "", further: str = "") -> list[str]:
    """Wrap a text at spaces only."""
    return wrap(
        " ".join(text.split()), width, initial_indent=indent, subsequent_indent=further,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _options(command: Any, ctx: Any) -> dict[str, Rows]:
    """Return names and descriptions of the arguments and options, by title of the group."""
    panels: dict[str, Rows] = {}
    params = command.get_params(ctx)
    options = sorted((param for param in params if isinstance(param, TyperOption)), key=_rank)
    for param in (*(param for param in params if param not in options), *options):
        title = _title(param, options) if isinstance(param, TyperOption) else "Arguments"
        if record := param.get_help_record(ctx):  # None if the option is hidden
            name, text = record
            panels.setdefault(title, []).append((name.replace(" range>", ">"), text.replace("\\[", "[")))
    order = ["Arguments", *OPTION_GROUPS, REST]
    return dict(sorted(panels.items(), key=lambda panel: order.index(panel[0])))


def _commands(command: Any, ctx: Any) -> dict[str, Rows]:
    """Return names and descriptions of a group's commands, by title in `COMMAND_GROUPS`."""
    inner = {name: each.help.split("\n\n")[0] for name, each in getattr(command, "commands", {}).items()}
    panels = {}
    if ctx.parent is None:
        for title, names in COMMAND_GROUPS.items():
            if rows := [(name, inner.pop(name)) for name in names if name in inner]:
                panels[title] = rows
    return {**panels, "Commands": list(inner.items())} if inner else panels


def _rank(option: TyperOption) -> float:
    """Return the sort key of an option: common options first, --json and --help last."""
    common = OPTION_GROUPS["Options"]
    found = [common.index(flag) for flag in option.opts if flag in common]
    return found[0] if found else common.index("--json") - 0.5


def _title(option: TyperOption, options: Sequence[TyperOption]) -> str:
    """Return the title of an option's group; `REST` if the command has no other option of that group."""
    if len(options) <= FEW:
        return "Options"
    flags = {flag for each in options for flag in each.opts}
    for title, group in OPTION_GROUPS.items():
        if set(option.opts) & set(group):
            return title if len(flags & set(group)) > 1 else REST
    return REST


def _print_panel(console: "Console", title: str, rows: Rows) -> None:
    from rich.panel import Panel
    from rich.text import Text

    edge = 2 + min(NAME_COLUMNS, max(len(name) for name, _ in rows))
    text = Text()
    for name, description in rows:
        lines = _folded(description, console.width - 4 - edge)
        text.append(name.ljust(edge), "bold cyan")
        if len(name) > edge - 2:
            lines.insert(0, "")
        text.append(f"\n{' ' * edge}".join(lines) + "\n")
    text.rstrip()
    console.print(Panel(text, title=title, title_align="left", border_style="dim"))
