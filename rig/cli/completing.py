"""Complete names with the Tab key, without slow imports."""

import os
import tomllib
from collections.abc import Callable
from glob import glob, has_magic
from pathlib import Path

ESTIMATOR_NAMES = (
    "slip", "skeleton", "ellipse", "pca", "skeleton-published", "ellipse-published", "pca-published", "ecc",
    "kolamuri", "anglenet", "toskov",
)  # fmt: skip
FORMAT_NAMES = (
    "csv",
    "parquet",
    "coco",
    "labelme",
    "lerobot",
    "rosbag2",
)
PACKAGE = Path(__file__).parents[2]


def objects() -> list[str]:
    """Return the names of the package's objects, and of those in `objects/` of the current folder."""
    files = [*(PACKAGE / "protocols" / "objects").glob("*.toml"), *Path("objects").glob("*.toml")]
    found = []
    for file in sorted(files):
        try:
            found.append(str(tomllib.loads(file.read_text(encoding="utf-8"))["name"]))
        except (OSError, ValueError, KeyError):  # not an object file
            continue
    bash = os.environ.get("_RIG_COMPLETE") == "complete_bash"  # bash inserts the word without quoting it
    return [name.replace(" ", "\\ ") for name in found] if bash else found


def benches(begun: str) -> list[str]:
    """Return the built-in benches and the bench files whose path begins as typed."""
    names = sorted(file.stem for file in (PACKAGE / "rig" / "benches").glob("*.toml"))
    return [*names, *_paths(begun, "*.toml")]


def sessions(begun: str) -> list[str]:
    """Return the session folders in `sessions/`, and those whose path begins as typed."""
    manifests = {*_paths(begun, "*/session.json"), *glob("sessions/*/session.json")}
    return sorted(str(Path(manifest).parent) for manifest in manifests)


def _paths(begun: str, ending: str) -> list[str]:
    return [] if has_magic(begun) else sorted(glob(f"{begun}{ending}"))


COMPLETED: dict[str, Callable[..., list[str]]] = {
    "--object": objects,
    "name": objects,
    "--estimator": lambda: list(ESTIMATOR_NAMES),
    "--to": lambda: list(FORMAT_NAMES),
    "--bench": benches,
    "session": sessions,
    "sessions": sessions,
    "sources": sessions,
    "first": sessions,
    "second": sessions,
    "--session": sessions,
    "--beside": sessions,
    "--on": sessions,
}
"""By option or argument: function that returns its possible values for the text typed so far."""
