"""Read files up to a size limit, write them atomically, order their names, print untrusted bytes."""

import codecs
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from decimal import Decimal
from pathlib import Path

from drivers.errors import FormatError

_LONGEST_REASON, _LONGEST_VALUE = 160, 60
"""Most characters of a reason and of a value in an error message."""

_LOGIN = re.compile(r"(://[^/@\s:]*):[^/\s]*@")
_SECRET = re.compile(r"([?&][^=&\s]*(?:pass|pwd|token|secret|auth|key)[^=&\s]*=)[^&\s'\"]+", re.IGNORECASE)


def without_passwords(text: str) -> str:
    """Replace the passwords of web addresses in a text by ***."""
    return _SECRET.sub(r"\1***", _LOGIN.sub(r"\1:***@", text))


def read_beginning(path: Path, most_bytes: int) -> bytes:
    """Read the first bytes of a file, at most `most_bytes`. Raises `FormatError` if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(most_bytes)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise FormatError(f"{path}: cannot be read ({reason(error)})") from error


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most `most_bytes`. Raises `FormatError`, also if it cannot be read."""
    data = read_beginning(path, most_bytes + 1)
    if len(data) > most_bytes:
        raise FormatError(f"{path}: is larger than the size limit of {most_bytes / 1e6:g} MB")
    return data


def read_text(path: Path, most_bytes: int) -> str:
    """Read UTF-8, with or without a byte order mark, or UTF-16 with one. Raises `FormatError`."""
    data = read_bounded(path, most_bytes)
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: cannot be read as text ({reason(error)})") from error


def shown(value: object) -> str:
    """Return an untrusted value for an error message, shortened and without passwords."""
    text = without_passwords(repr(value))
    return text if len(text) <= _LONGEST_VALUE else text[:_LONGEST_VALUE] + "..."


def reason(error: BaseException) -> str:
    """Return why an operation failed: one printable line, without passwords."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    text = text.partition("; use sys.")[0]  # Python's advice to programmers on very long numbers
    line = without_passwords(" ".join(text.encode("utf-8", "backslashreplace").decode().split()))
    return line if len(line) <= _LONGEST_REASON else line[:_LONGEST_REASON] + " ..."


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically: to a temporary file, synced, then renamed. Raises `OSError`.

    If writing fails, the temporary file is deleted.
    """
    aside = path.with_name(path.name + ".part")
    try:
        with aside.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(path)
    except OSError:
        with suppress(OSError):
            aside.unlink()
        raise


_POINT = r"(?<![0-9])(?<![0-9]\.)[0-9]+\.{}(?:e[+-][0-9]{{1,2}})?(?!\.?[0-9])"
"""A decimal number that is no part of a longer chain, such as a date, 2026.11.26."""
_FRACTION = re.compile(_POINT.format("([0-9]+)"))
_DECIMAL = re.compile(f"((?:^-)?(?:{_POINT.format('[0-9]+')}|[0-9]+(?:e[+-][0-9]{{1,2}})?))")
_WHOLE = re.compile("((?:^-)?[0-9]+)")


def in_number_order(files: Iterable[Path]) -> list[Path]:
    """Return files sorted by name: 2.png before 10.png, 0.1337035.png before 0.867143.png.

    Digits with one point are a decimal number, as in names that are times, if all have equally many digits
    after the point, or none ends with a 0, which programs leave out. Otherwise they are two integers, as in
    1.9.png and 1.10.png, frames of lift 1.
    """
    files = list(files)
    fractions = [fraction for file in files for fraction in _FRACTION.findall(file.stem)]
    one_width = len({len(fraction) for fraction in fractions}) < 2
    no_end_zero = not any(fraction.endswith("0") and len(fraction) > 1 for fraction in fractions)
    number = _DECIMAL if one_width or no_end_zero else _WHOLE

    def key(file: Path) -> tuple[list[str | Decimal], str]:
        parts = number.split(file.stem)  # text and numbers take turns
        return [Decimal(part) if place % 2 else part for place, part in enumerate(parts)], file.name

    return sorted(files, key=key)
