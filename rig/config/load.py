"""Read a bench file; report errors with their lines."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.errors import InputError, no_such, plural, unknown_name
from drivers.formats import MOST_TOML_BYTES, parse_toml, read_text
from rig.config.checks import inconsistencies
from rig.config.devices import TactileConfig
from rig.config.fields import KeyFault
from rig.config.messages import faults_of, refusal
from rig.config.models import BenchConfig

BENCHES = Path(__file__).parent.parent / "benches"
PLACEHOLDER = "ENTER "
"""Beginning of each value that the template of a bench file leaves to the user."""
FOUND_ELSEWHERE = {
    "calibrations": "must not be in a bench file; they are found beside it",
    "objects": "must not be in a bench file, but in separate files (rig objects new FILE)",
}
"""Keys of a bench that its file does not have."""


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

    def beside(tactile: TactileConfig) -> TactileConfig:
        named = {key: getattr(tactile, key, None) for key in ("look", "gel")}
        return tactile.model_copy(
            update={key: str(path.parent / name) for key, name in named.items() if name}
        )

    return config.model_copy(update={"tactile": tuple(map(beside, config.tactile))})


def parse_bench(text: str, name: str) -> BenchConfig:
    """Read the text of a bench file; `name` is its name in messages. Raises `InputError`."""
    values = parse_toml(text, name)
    if to_enter := list(_placeholders(values, ())):
        left = plural(len(to_enter), "value")
        raise refusal(name, to_enter, text, f"{name}: {left} to enter; nothing was connected")
    if elsewhere := [((key,), FOUND_ELSEWHERE[key]) for key in FOUND_ELSEWHERE if key in values]:
        raise refusal(name, elsewhere, text)
    # through JSON: lists become tuples, but types are otherwise strict (no true for 1, no "5" for 5)
    document = json.dumps(values, default=str)
    try:
        config = BenchConfig.model_validate_json(document, strict=True)
    except ValidationError as error:
        raise refusal(name, faults_of(error, BenchConfig), text) from error
    require_consistent(config, name, text)
    return config


def require_consistent(config: BenchConfig, name: str, text: str | None = None) -> None:
    """Raise `InputError` if keys of a bench contradict each other. name, text: of its file, for messages."""
    if wrong := list(inconsistencies(config)):
        raise refusal(name, wrong, text)


def _placeholders(value: Any, where: tuple[str | int, ...]) -> Iterator[KeyFault]:
    if isinstance(value, str) and value.startswith(PLACEHOLDER):
        yield where, value.replace(PLACEHOLDER, "enter ", 1)
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _placeholders(inner, (*where, key))


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
