"""A row of the table, and the versions of packages and clones."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rig.benchmark.harness import column


@dataclass(frozen=True, slots=True)
class Row:
    """One client or reader. met: whether the result is as expected; None if it was skipped."""

    part: str = column("part")
    what: str = column("what")
    version: str = column("version")
    result: str = column("result")
    met: bool | None = column("passed", lambda met: {True: "yes", False: "NO", None: ""}[met])


Say = Callable[[str], None]


def skipped(part: str, what: str, reason: str) -> Row:
    """Return the row of a missing client or reader, with how to install it."""
    return Row(part, what, "", f"skipped: {reason}", None)


def installed(package: str) -> str | None:
    """Return the version of a package, None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def clone_of(repository: str, clones: Path | None) -> Path | None:
    """Return the folder of a clone, `clones/OWNER/NAME`, None if it does not exist."""
    folder = clones / repository if clones is not None else None
    return folder if folder is not None and folder.is_dir() else None


def how_to_clone(repository: str) -> str:
    """Return how to get a missing clone."""
    return f"git clone https://github.com/{repository} CLONES/{repository}, then --clones CLONES"


def commit_of(clone: Path) -> str:
    """Return the short commit of a clone from its git folder, "unknown" if there is none."""
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
