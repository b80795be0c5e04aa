"""A lab's own objects: read the object files of a folder, in addition to the package's."""

import json
import re
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError

from drivers.errors import InputError, nearest
from drivers.formats import MOST_TOML_BYTES, parse_toml, read_text
from protocols.grasps import OBJECTS_FOLDER, GraspFile, load_grasp_files
from rig.config.load import write_new
from rig.config.messages import faults_of, refusal
from rig.config.models import BenchConfig

FOLDER = "objects"
MOST_FILES = 1000
"""Most object files read from a folder."""
_POSITION = re.compile(r"\s*\[\[\s*position\s*\]\]")
_TABLE = re.compile(r"\s*\[")
_VALUE = re.compile(r"\s*(?P<key>[\w-]+)\s*=\s*(?P<value>\"[^\"]*\"|'[^']*'|[^#\s]+)(?P<rest>\s*(?:#.*)?)$")


def objects_folder(bench: str, given: Path | None = None) -> Path | None:
    """Return the folder of a lab's objects: the given one, or `objects/` beside the bench file if it exists.

    bench: name or path; for a built-in bench, `objects/` in the current folder. Raises `InputError` if a
    given folder does not exist.
    """
    if given is not None:
        if not given.is_dir():
            raise InputError(
                f"--objects {given}: no such folder; 'rig objects new FILE' writes a file to begin"
            )
        return given
    path = Path(bench)
    folder = (path.parent if path.is_file() else Path()) / FOLDER
    found = folder.is_dir() and folder.resolve() != OBJECTS_FOLDER.resolve()
    return folder if found else None


def read_objects(folder: Path) -> dict[Path, GraspFile]:
    """Read the objects of a folder, by file. Raises `InputError` naming the file and, if known, the line.

    Ids and names must be unique, also among the package's objects.
    """
    paths = sorted(folder.glob("*.toml"))
    if len(paths) > MOST_FILES:
        raise InputError(f"{folder}: contains {len(paths)} files; at most {MOST_FILES} are read")
    found: dict[Path, GraspFile] = {}
    taken = {name: "the package" for own in load_grasp_files().values() for name in own.names}
    for path in paths:
        text = read_text(path, MOST_TOML_BYTES)
        found[path] = read = parse_object(text, str(path))
        for key, name in zip(("id", "name"), read.names, strict=True):
            if name in taken:
                why = f"'{name}' is an object of {taken[name]} already; give it another one"
                raise refusal(str(path), [([key], why)], text)
        taken |= dict.fromkeys(read.names, str(path))
    return found


def parse_object(text: str, name: str) -> GraspFile:
    """Parse an object file; `name` is its name in messages. Raises `InputError`."""
    document = json.dumps(parse_toml(text, name), default=str)
    try:
        return GraspFile.model_validate_json(document, strict=True)
    except ValidationError as error:
        raise refusal(name, faults_of(error, GraspFile), text) from error


def with_objects(config: BenchConfig, bench: str, given: Path | None = None) -> BenchConfig:
    """Return a bench with a lab's objects added. Raises `InputError`.

    bench, given: as in `objects_folder`.
    """
    folder = objects_folder(bench, given)
    return config if folder is None else with_more(config, read_objects(folder).values())


def own_object(name: str, bench: str, given: Path | None = None) -> tuple[Path, GraspFile]:
    """Find one of a lab's own objects, and its file. bench, given: as in `objects_folder`.

    Raises `InputError` for the package's objects, which must not be changed, and for unknown ones.
    """
    folder = objects_folder(bench, given)
    files = read_objects(folder) if folder else {}
    wanted = " ".join(name.lower().split())
    for path, each in files.items():
        if wanted in each.names:
            return path, each
    begin = f"begin one with: rig objects new {folder or FOLDER}/FILE.toml"
    if any(wanted in each.names for each in load_grasp_files().values()):
        raise InputError(f"'{name}' is an object of the package, whose file cannot be changed; {begin}")
    own = ", ".join(each.id for each in files.values()) or "none"
    near = nearest(wanted, [known for each in files.values() for known in each.names])
    raise InputError(f"you have no object called '{name}'{near} (your objects: {own}); {begin}")


def with_more(config: BenchConfig, objects: Iterable[GraspFile]) -> BenchConfig:
    """Return a bench with further objects, such as those stored in a session; its own of the same id stay."""
    known = {own.id for own in config.objects}
    more = [each for each in objects if each.id not in known]
    return config.model_copy(update={"objects": (*config.objects, *more)}) if more else config


def with_objects_of(config: BenchConfig, ids: Collection[str]) -> BenchConfig:
    """Return a bench with only these of a lab's objects, for storing it in a session."""
    return config.model_copy(update={"objects": tuple(each for each in config.objects if each.id in ids)})


def new_object_text(called: str) -> str:
    """Return an object file that explains each key. called: text from which its id and name are made."""
    text = Path(__file__).with_name("new_object.toml").read_text(encoding="utf-8")
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in called)
    own_id = plain.lstrip("_-")[:40] or "my_object"
    return text.replace('"my_object"', f'"{own_id}"').replace('"my object"', f'"{own_id.replace("_", " ")}"')


def new_object_file(path: Path) -> None:
    """Write an object file that explains each key, named after the file, and create its folder.

    Raises `InputError`; never overwrites.
    """
    with suppress(OSError):  # opening the file then reports why there is no folder
        path.parent.mkdir(parents=True, exist_ok=True)
    write_new(path, new_object_text(path.stem))


def with_position(text: str, name: str, values: Mapping[str, float], where: str) -> tuple[str, GraspFile]:
    """Return an object file's text with changed values of a position, and the object read from it.

    values: by key, as {"offset_m": -0.05}. A missing position is added; comments are kept. where: the file's
    name in messages. Raises `InputError` if the file's notation is not supported.
    """
    lines = text.splitlines()
    found = (line and (line["key"], line["value"][1:-1]) for line in map(_VALUE.match, lines))
    named = [number for number, pair in enumerate(found) if pair == ("name", name)]
    block = next((b for b in _blocks(lines) if any(number in b for number in named)), None)
    if block is None:
        lines = _add(lines, name, values)
    else:
        lines[block.start : block.stop] = _change(lines[block.start : block.stop], values)
    changed = "\n".join(lines) + "\n"
    read = parse_object(changed, where)
    place = next((position for position in read.position if position.name == name), None)
    if place is None or any(getattr(place, key) != value for key, value in values.items()):
        wanted = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        raise InputError(f"{where}: cannot be changed automatically; enter at '{name}': {wanted}")
    return changed, read


def _blocks(lines: list[str]) -> list[range]:
    found = []
    for start in (i for i, line in enumerate(lines) if _POSITION.match(line)):
        ends = (i for i in range(start + 1, len(lines)) if _TABLE.match(lines[i]))
        found.append(range(start, next(ends, len(lines))))
    return found


def _change(block: list[str], values: Mapping[str, float]) -> list[str]:
    """Change the existing lines of a position, and append the other keys after the last of them."""
    left, lines, last = dict(values), [], 0
    for line in block:
        found = _VALUE.match(line)
        if found and found["key"] in left:
            line = _with_value(found, left.pop(found["key"]))
        if found:
            last = len(lines)
        lines.append(line)
    return [*lines[: last + 1], *(f"{key} = {value:g}" for key, value in left.items()), *lines[last + 1 :]]


def _with_value(line: re.Match[str], value: float) -> str:
    """Return a line with another value, with its comment at the same column if possible."""
    written, comment = line.string[: line.start("value")] + f"{value:g}", line["rest"].strip()
    column = line.end("rest") - len(comment) - 1
    return f"{written:<{column}} {comment}" if comment else written


def _add(lines: list[str], name: str, values: Mapping[str, float]) -> list[str]:
    new = ["[[position]]", f'name = "{name}"', *(f"{key} = {value:g}" for key, value in values.items()), ""]
    blocks = _blocks(lines)
    end = blocks[-1].stop if blocks else len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    return [*lines[:end], "", *new, *lines[end:]]
