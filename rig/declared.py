"""Options of commands, declared as frozen dataclasses.

If the type of a command's parameter is a dataclass, each of its fields becomes an option, and the command is
called with the dataclass. Commands share options in this way without repeating them. A field is declared by
`option` or `argument`, or by typer's own annotation, as `Annotated[int, typer.Option("--lifts",
help="...")]`.
"""

import os
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, is_dataclass, replace
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from drivers.errors import InputError

Options = TypeVar("Options")


def with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command for typer in which every dataclass parameter is replaced by its fields."""
    hints = get_type_hints(command, include_extras=True)
    declared: dict[str, Any] = {name: hints[name] for name in signature(command).parameters}
    flat: list[Parameter] = []
    for name, parameter in signature(command).parameters.items():
        kind = declared[name]
        if is_dataclass(kind):
            flat += option_parameters(kind)
        else:
            flat.append(parameter.replace(annotation=kind, kind=Parameter.KEYWORD_ONLY))

    def call(**values: Any) -> Any:
        given: dict[str, Any] = {}
        for name, make in declared.items():
            if is_dataclass(hints[name]):
                given[name] = make(**{each.name: values[each.name] for each in fields(make)})
            else:
                given[name] = values[name]
        return command(**given)

    set_signature(call, flat)
    call.__name__, call.__doc__ = command.__name__, command.__doc__
    return call


def option(
    default: Any,
    text: str = "",
    *flags: str,
    stored: str = "",
    read: Callable[[Any], Any] = lambda value: value,
    **settings: Any,
) -> Any:
    """Declare a field of a dataclass as an option.

    default: value if the option is not given; `...` if it is required. text: its help; if empty, the field's
    type is annotated for typer already. flags: its names; by default the field's name. stored: field of the
    manifest that stores the value for --resume. read: converts the manifest's value to the option's.
    settings: further arguments of `typer.Option`.
    """
    made = [typer.Option, flags, {"help": text, **settings}] if text else None
    return _field(default, {"typer": made, "stored": stored, "read": read})


def argument(default: Any, text: str, **settings: Any) -> Any:
    """Declare a field of a dataclass as an argument.

    default: `...` if it is required. settings: further arguments of `typer.Argument`.
    """
    return _field(default, {"typer": [typer.Argument, (), {"help": text, **settings}]})


def resume_options(options: Options, manifest: Any, context: typer.Context) -> Options:
    """Return the options of a resumed session: given ones from the command line, all others as stored."""
    of: Any = options
    stored = {
        each.name: each.metadata["read"](getattr(manifest, each.metadata["stored"]))
        for each in fields(of)
        if each.metadata.get("stored") and not is_given(context, each.name)
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
            annotation=_for_typer(each, hints[each.name]),
        )
        for each in fields(kind)
    ]


def set_signature(function: Any, parameters: list[Parameter]) -> None:
    """Set the parameters that typer reads from a function."""
    function.__signature__ = Signature(parameters)
    function.__annotations__ = {each.name: each.annotation for each in parameters}


def _field(default: Any, metadata: dict[str, Any]) -> Any:
    return field(metadata=metadata) if default is ... else field(default=default, metadata=metadata)


def _for_typer(each: Field[Any], hint: Any) -> Any:
    """Return the type of a field, annotated for typer."""
    if not each.metadata.get("typer"):
        return hint
    make, flags, settings = each.metadata["typer"]
    if make is typer.Option and not flags:
        flags = (f"--{each.name.replace('_', '-')}",)  # typer would add --no-NAME to a switch
    return Annotated[hint, make(*flags, **settings)]


def file_place(path: Path | None) -> Path | None:
    """Return the path of a file. Raises `InputError` if no file can be written there."""
    if path is None:
        return None
    if path.exists() and not path.is_file():
        raise InputError(
            f"{path}: is {'a folder' if path.is_dir() else 'not a file'}; give the name of a file"
        )
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; create it, or choose another path")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise InputError(f"{path}: cannot be written; choose another path")
    return path


def folder_place(path: Path | None) -> Path | None:
    """Return the path of a folder that exists or can be created. Raises `InputError` if it cannot."""
    if path is None:
        return None
    there = next(place for place in (path.absolute(), *path.absolute().parents) if os.path.lexists(place))
    if not there.is_dir():
        raise InputError(f"{path}: {there} is a file; give a folder")
    if not os.access(there, os.W_OK):
        raise InputError(f"{path}: cannot be written; choose another folder")
    return path
