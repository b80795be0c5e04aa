"""Write bench files as TOML text, for example for `rig fakes serve`."""

import json
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from rig.config.checks import BESIDE_ARM, BESIDE_GRIPPER
from rig.config.models import BenchConfig


def bench_text(config: BenchConfig) -> str:
    """Return a bench as TOML that reads back as the same bench: every key that differs from its default.

    Required keys are also written if they equal their default.
    """
    # objects are found beside a bench file, so they are not written into it
    values = config.model_dump(mode="json", exclude_defaults=True, exclude={"objects"})
    if config.has("arm", "camera"):
        values["camera"] |= {key: list(getattr(config.camera, key)) for key in BESIDE_ARM}
    if config.has("gripper"):
        for table, tactile in zip(values.get("tactile", ()), config.tactile, strict=True):
            table |= {key: getattr(tactile, key) for key in BESIDE_GRIPPER}
    plain = {key: value for key, value in values.items() if not isinstance(value, dict | list)}
    parts = [_keys(plain)]
    for key, value in values.items():
        if isinstance(value, dict):
            parts.append(_table(key, value))
        elif isinstance(value, list):
            parts += [f"[[{key}]]\n{_keys(item)}" for item in value]
    return "\n".join(parts)


def write_bench(path: Path, config: BenchConfig) -> None:
    """Write a bench file; an existing file is overwritten. Raises `InputError`."""
    try:
        path.write_text(bench_text(config))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another name") from error


def _table(name: str, values: dict[str, Any]) -> str:
    inner = {key: value for key, value in values.items() if isinstance(value, dict)}
    own = {key: value for key, value in values.items() if key not in inner}
    return "\n".join([f"[{name}]\n{_keys(own)}", *(_table(f"{name}.{key}", v) for key, v in inner.items())])


def _keys(values: dict[str, Any]) -> str:
    # TOML strings, numbers, booleans and arrays of them have the same notation as JSON.
    return "".join(f"{key} = {_value(value)}\n" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(key)} = {_value(of)}" for key, of in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, ensure_ascii=False)
