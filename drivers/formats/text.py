"""Read files up to a size limit, write files atomically, and print untrusted bytes in error messages."""

import codecs
import os
import re
from contextlib import suppress
from pathlib import Path

from drivers.errors import FormatError

_LONGEST_REASON, _LONGEST_VALUE = 160, 60
"""Most characters of a reason and of a value in an error message."""

_LOGIN = re.compile(r"(://[^/@\s:]*):[^/\s]*@")
_SECRET = re.compile(r"([?&][^=&\s]*(?:pass|pwd|token|secret|auth|key)[^=&\s]*=)[^&\s'\"]+", re.IGNORECASE)


def without_passwords(text: str) -> str:
    """Replace the passwords of web addresses in a text by ***."""
    return _SECRET.sub(r"\1***", _LOGIN.sub(r"\1:***@", text))


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most `most_bytes`. Raises `FormatError`, also if it cannot be read."""
    try:
        with path.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise FormatError(f"{path}: cannot be read ({reason(error)})") from error
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
