"""A benchmark's table in a README, between two marker lines."""

from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError


def markers(name: str) -> tuple[str, str]:
    """Return the two lines between which the table of `rig benchmark NAME` stands."""
    return f"<!-- rig benchmark {name}: begin -->", f"<!-- rig benchmark {name}: end -->"


def check_readme(path: Path, name: str) -> None:
    """Raise `InputError` unless a file has the two marker lines, once each and in order."""
    begin, end = markers(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if not (text.count(begin) == text.count(end) == 1 and text.index(begin) < text.index(end)):
        raise InputError(f"{path}: put these two lines where the table belongs: {begin} and {end}")


def write_section(path: Path, name: str, section: str) -> None:
    """Replace what stands between the two markers. Raises `InputError` where they are not there."""
    check_readme(path, name)
    begin, end = markers(name)
    head, _, rest = path.read_text(encoding="utf-8").partition(begin)
    path.write_text(f"{head}{begin}\n{section}\n{end}{rest.partition(end)[2]}", encoding="utf-8")


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown. A "|" in a cell is written as "/"."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |" for cells in lines)
