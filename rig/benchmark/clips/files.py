"""The files that `rig benchmark clips` leaves."""

import json
from pathlib import Path

from rig.benchmark.clips.benchmark import ClipsResult, as_json
from rig.benchmark.clips.page import page
from rig.benchmark.clips.tables import NAME, readme_section
from rig.benchmark.readme import write_section

FIGURES, PAGE, TABLE = "results.json", "index.html", "table.md"


def write_clips(folder: Path, result: ClipsResult, readme: Path | None = None) -> None:
    """Write results, page and table into a folder that there is, and the table into a README."""
    section = readme_section(result)
    (folder / FIGURES).write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(page(result), encoding="utf-8")
    (folder / TABLE).write_text(section + "\n", encoding="utf-8")
    if readme is not None:
        write_section(readme, NAME, section)
