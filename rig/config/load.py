"""Read a bench file; report errors with their lines."""

import json
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.errors import FormatError, InputError, counted, nearest, no_such, unknown_name
from drivers.formats import MOST_TOML_BYTES, parse_toml, read_text, shown
from rig.config.checks import inconsistencies, missing_keys, unused_keys
from rig.config.fields import KeyFault, KeyPath
from rig.config.models import BenchConfig, known_keys

BENCHES = Path(__file__).parent.parent / "benches"
PLACEHOLDER = "ENTER "
"""Beginning of each value that the template of a bench file leaves to the user."""
MOST_LINES = 500
"""Most lines of a bench file that are searched for a key: the time grows with the square of the lines."""
MOST_FAULTS = 4
"""Most faults listed in one message."""


def load_bench(name_or_path: str) -> BenchConfig:
    """Read a bench by name (`fake`, `hard`, `wire`) or from a file.

    Raises `InputError` naming the file and, for each invalid key, its line.
    """
    path = BENCHES / f"{name_or_path}.toml"
    if not path.exists():
        path = Path(name_or_path)
    if not path.is_file():
        if path.suffix or path.name != name_or_path:
            raise InputError(no_such(path, "file", "rig bench new FILE writes a bench file"))
        known = sorted(file.stem for file in BENCHES.glob("*.toml"))
        also = ", or give the path of a bench file (rig bench new FILE writes one)"
        raise unknown_name("bench", name_or_path, known, also)
    config = parse_bench(read_text(path, MOST_TOML_BYTES), str(path))

    def placed(name: str | None) -> str | None:
        return name and str(path.parent / name)

    found = [t.model_copy(update={"look": placed(t.look), "gel": placed(t.gel)}) for t in config.tactile]
    return config.model_copy(update={"tactile": tuple(found)})


def parse_bench(text: str, name: str) -> BenchConfig:
    """Read the text of a bench file; `name` is its name in messages. Raises `InputError`."""
    try:
        values = parse_toml(text, name)
        if to_enter := list(_placeholders(values, ())):
            left, where = counted(len(to_enter), "value"), _text(to_enter, text, most=None)
            raise InputError(f"{name}: {left} to enter; nothing was connected: {where}")
        # through JSON: lists become tuples, but types are otherwise strict (no true for 1, no "5" for 5)
        document = json.dumps(values, default=str)
        config = BenchConfig.model_validate_json(document, strict=True)
    except ValidationError as error:
        raise InputError(f"{name}: {validation_text(error, text)}") from error
    wrong = [*inconsistencies(config), *missing_keys(config), *unused_keys(config)]
    if wrong:
        raise InputError(f"{name}: {_text(wrong, text)}")
    return config


def require_consistent(config: BenchConfig, name: str) -> None:
    """Raise `InputError` if keys of a bench contradict each other. name: of its file in the message."""
    if wrong := list(inconsistencies(config)):
        raise InputError(f"{name}: {_text(wrong, None)}")


def _placeholders(value: Any, where: tuple[str | int, ...]) -> Iterator[KeyFault]:
    if isinstance(value, str) and value.startswith(PLACEHOLDER):
        yield where, value.replace(PLACEHOLDER, "enter ", 1)
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _placeholders(inner, (*where, key))


def validation_text(
    error: ValidationError, source: str | None = None, known: Collection[str] | None = None
) -> str:
    """Return one line that names the invalid keys with reasons, and with their places if `source` is given.

    known: all valid keys, by default those of bench files.
    """
    every = error.errors()
    keys = known_keys() if known is None else set(known)
    named = [(details["loc"], _reason(details, keys)) for details in every[:MOST_FAULTS]]
    return _text(named, source, len(every))


def _text(
    faults: Sequence[KeyFault], source: str | None, count: int | None = None, most: int | None = MOST_FAULTS
) -> str:
    """Return the first faults with their places.

    count: number of all faults, by default of `faults`. most: number of faults to list; None for all.
    """
    parts = []
    for loc, why in faults[:most]:
        place = f"{place_of(source, loc)}: " if source is not None else ""
        parts.append(f"{place}{'.'.join(map(str, loc)) or 'file'}: {why}")
    more = (count or len(faults)) - len(parts)
    return "; ".join(parts) + (f"; and {more} more" if more > 0 else "")


def _reason(details: Any, known: set[str]) -> str:
    if details["type"] == "extra_forbidden":
        key = str(details["loc"][-1])
        return f"unknown key{nearest(key, known - {key})}"
    found = "" if details["type"] == "missing" else f", found {shown(details['input'])}"
    return f"{details['msg'].removeprefix('Value error, ')}{found}"


def new_bench_file(path: Path) -> None:
    """Write a bench file that explains each key. Raises `InputError`; never overwrites."""
    write_new(path, Path(__file__).with_name("new_bench.toml").read_text(encoding="utf-8"))


def write_new(path: Path, text: str) -> None:
    """Write a new text file. Raises `InputError` if it exists or cannot be written."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        raise InputError(f"{path} exists already: give another name, or move it aside") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another path") from error


def place_of(text: str, path: KeyPath) -> str:
    """Return where a key of valid TOML is, as "line 3, column 5"; see `line_of`."""
    number = line_of(text, path)
    line = (text.split("\n") or [""])[number - 1]
    key = next((step for step in reversed(path) if isinstance(step, str)), "")
    found = re.search(rf"\b{re.escape(key)}\b", line) if key else None
    start = found.start() if found else len(line) - len(line.lstrip())
    return f"line {number}, column {start + 1}"


def line_of(text: str, path: KeyPath) -> int:
    """Return the 1-based line on which a key, table or element of valid TOML begins.

    A missing key counts as being on the line where its nearest table begins. An empty path is line 1, and so
    are keys beyond `MOST_LINES`.

    The file is parsed repeatedly with one more line until the key exists: this needs no second TOML grammar,
    and bench files are short.
    """
    wanted = _present_part(parse_toml(text, ""), path)
    for begin, document in _grown(text) if wanted else ():
        if _present_part(document, wanted) == wanted:
            rest = enumerate(text.split("\n")[begin:], begin + 1)
            return next(number for number, line in rest if _has_content(line))
    return 1


@lru_cache(maxsize=1)
def _grown(text: str) -> list[tuple[int, Any]]:
    """Return the document up to each line, with the number of lines before its last statement."""
    lines, readable = text.split("\n"), 0
    grown: list[tuple[int, Any]] = []
    for count in range(1, min(len(lines), MOST_LINES) + 1):
        if not _has_content(lines[count - 1]):
            continue
        with suppress(FormatError):  # in the middle of a multi-line value
            grown.append((readable, parse_toml("\n".join(lines[:count]), "")))
            readable = count
    return grown


def _present_part(document: Any, path: KeyPath) -> list[str | int]:
    """Return the longest existing prefix of a path."""
    found: list[str | int] = []
    for step in path:
        if isinstance(document, dict) and step in document:
            document = document[step]
        elif isinstance(document, list) and isinstance(step, int) and step < len(document):
            document = document[step]
        else:
            break
        found.append(step)
    return found


def _has_content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")
