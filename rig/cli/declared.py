"""Options of commands, declared as frozen dataclasses.

A parameter of a command whose type is a dataclass becomes one option per field; the command is called with
the dataclass. So commands share options without repeating them.
"""

from collections.abc import Callable
from dataclasses import MISSING, field, fields, is_dataclass, replace
from inspect import Parameter, Signature, signature
from typing import Any, TypeVar, get_type_hints

import typer

Options = TypeVar("Options")


def with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command for typer: every parameter that is a dataclass is replaced by its fields.

    The fields' types carry what typer needs, as `Annotated[int, typer.Option("--lifts", help="...")]`.
    """
    hints = get_type_hints(command, include_extras=True)
    declared: dict[str, Any] = {name: hints[name] for name in signature(command).parameters}
    flat: list[Parameter] = []
    for name, parameter in signature(command).parameters.items():
        kind = declared[name]
        if is_dataclass(kind):
            flat += option_parameters(kind)
        else:
            flat.append(parameter.replace(annotation=kind, kind=Parameter.KEYWORD_ONLY))

    def called(**values: Any) -> Any:
        return command(**{name: _argument(name, kind, values) for name, kind in declared.items()})

    set_signature(called, flat)
    called.__name__, called.__doc__ = command.__name__, command.__doc__
    return called


def stored_as(name: str, default: Any, read: Callable[[Any], Any] = lambda value: value) -> Any:
    """Declare an option whose value is stored with a session, for its resumption.

    name: of the manifest's field. default: of the option. read: returns the option's value from the field's.
    """
    return field(default=default, metadata={"stored": name, "read": read})


def resumed(options: Options, manifest: Any, context: typer.Context) -> Options:
    """Return options for a session that is resumed: those of the command line, all others as stored."""
    of: Any = options
    stored = {
        each.name: each.metadata["read"](getattr(manifest, each.metadata["stored"]))
        for each in fields(of)
        if "stored" in each.metadata and not is_given(context, each.name)
    }
    return replace(of, **stored)


def is_given(context: typer.Context, option: str) -> bool:
    """Return whether an option is on the command line; if not, its value is the default."""
    source = context.get_parameter_source(option)
    return source is not None and source.name == "COMMANDLINE"


def option_parameters(kind: Any) -> list[Parameter]:
    """Return the fields of a dataclass as parameters of a function, with their defaults."""
    hints = get_type_hints(kind, include_extras=True)
    return [
        Parameter(
            each.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if each.default is MISSING else each.default,
            annotation=hints[each.name],
        )
        for each in fields(kind)
    ]


def set_signature(function: Any, parameters: list[Parameter]) -> None:
    """Set the parameters that typer reads from a function."""
    function.__signature__ = Signature(parameters)
    function.__annotations__ = {each.name: each.annotation for each in parameters}


def _argument(name: str, kind: Any, values: dict[str, Any]) -> Any:
    if not is_dataclass(kind):
        return values[name]
    make: Any = kind
    return make(**{each.name: values[each.name] for each in fields(kind)})
