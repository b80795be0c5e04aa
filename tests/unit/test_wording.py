"""Count words that make a sentence hard to read; `python FILE [PACKAGE]` lists them."""

import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNCLEAR = re.compile(
    r"\b(told|tells?|says?|nobody|somebody|look(s|ed)?\s+at|what\s+(is|has)|(that|which)\s+is\s+none|by\s+which"
    r"|so\s+(many|long)|of\s+(its|their)\s+own|anew|taken\s+for|(comes?|came)\s+of|is\s+to\s+be|where\s+it)\b",
    re.IGNORECASE,
)
"""Words that usually stand in a sentence that has to be read twice."""
CEILINGS = {
    ".": 1, "calibration": 7, "docs": 12, "drivers": 13, "fakes": 2, "protocols": 16, "rig": 2,
    "rig/bench": 5, "rig/benchmark": 9, "rig/calibrate": 12, "rig/cli": 106, "rig/config": 2,
    "rig/doctor": 1, "rig/experiments": 8, "rig/frames": 1, "rig/lift": 3,
    "rig/results": 1, "rig/sessions": 5,
    "rig/tactile": 3, "tests/cli": 6, "tests/contract": 4,
    "tests/scenario": 2, "tests/unit": 33,
}  # fmt: skip
"""Most uses per package. Lower a ceiling after rewriting; never raise one."""


def uses() -> Iterator[tuple[str, str]]:
    """Yield package and place of each use in the Python files and Markdown pages under version control."""
    command = ["git", "ls-files", "*.py", "*.md"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    for name in set(listed.stdout.split()) - {"tests/unit/test_wording.py"}:
        text = (ROOT / name).read_text(encoding="utf-8")
        for found in UNCLEAR.finditer(text):
            line = text.count("\n", 0, found.start()) + 1
            yield package(name), f"{name}:{line}: {' '.join(found[0].split())}"


def package(name: str) -> str:
    """Return the package of a file: `rig/live`, `drivers`, `docs`, or `.` for the pages at the top."""
    folders = Path(name).parts[:-1]
    return "/".join(folders[: 2 if folders[0] in ("rig", "tests") else 1]) if folders else "."


def test_unclear_words_stay_below_the_ceiling_of_their_package() -> None:
    places = list(uses())
    counts = Counter(of for of, _ in places)
    exceeded = {of: count for of, count in counts.items() if count > CEILINGS.get(of, 0)}
    assert not exceeded, "\n".join(place for of, place in places if of in exceeded)


if __name__ == "__main__":
    print(*(place for of, place in sorted(uses()) if of in sys.argv[1:]), sep="\n")
    print(*sorted(Counter(of for of, _ in uses()).items()), sep="\n")
