"""The files that `rig benchmark clips` leaves."""

import json
from pathlib import Path

from rig.benchmark.clips.benchmark import ClipsResult, as_json
from rig.benchmark.clips.page import page
from rig.benchmark.clips.tables import readme_section

FIGURES, PAGE, TABLE = "results.json", "index.html", "table.md"


def write_clips(folder: Path, result: ClipsResult) -> None:
    """Write results, page and table into a folder that there is."""
    (folder / FIGURES).write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(page(result), encoding="utf-8")
    (folder / TABLE).write_text(readme_section(result) + "\n", encoding="utf-8")
