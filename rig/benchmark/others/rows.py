"""A row of the table: what was run, of which version, what came out, ours beside theirs."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Row:
    """met: whether it came out as it should; None where it was skipped or nothing is asked."""

    part: str
    what: str
    version: str
    result: str
    ours: str = ""
    theirs: str = ""
    met: bool | None = None


Say = Callable[[str], None]


def skipped(part: str, what: str, reason: str) -> Row:
    """A row of what is not here, and how to get it."""
    return Row(part, what, "", f"skipped: {reason}")


def installed(package: str) -> str | None:
    """The version of a package; None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def clone_of(repository: str, clones: Path | None) -> Path | None:
    """The folder of a clone, `clones/OWNER/NAME`; None where there is none."""
    folder = clones / repository if clones is not None else None
    return folder if folder is not None and folder.is_dir() else None


def how_to_clone(repository: str) -> str:
    """What to do where a clone is missing."""
    return f"git clone https://github.com/{repository} CLONES/{repository}, then --clones CLONES"


def commit_of(clone: Path) -> str:
    """The short commit of a clone, read from its git folder; "unknown" where there is none."""
    head = clone / ".git" / "HEAD"
    if not head.is_file():
        return "unknown"
    text = head.read_text().strip()
    if text.startswith("ref: "):
        ref = clone / ".git" / text.removeprefix("ref: ")
        packed = clone / ".git" / "packed-refs"
        if ref.is_file():
            text = ref.read_text().strip()
        elif packed.is_file():
            name = text.removeprefix("ref: ")
            found = [line for line in packed.read_text().splitlines() if line.endswith(name)]
            text = found[0] if found else "unknown"
    return text[:7]
