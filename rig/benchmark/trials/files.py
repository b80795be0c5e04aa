"""The files that `rig benchmark trials` leaves."""

import json
from pathlib import Path

from markupsafe import Markup

from rig.benchmark.harness import machine
from rig.benchmark.trials.benchmark import TrialsResult, as_json
from rig.benchmark.trials.paper_tables import notes, table_four, table_three
from rig.benchmark.trials.picture import draw
from rig.pages.page import render

FIGURES, PICTURE, PAGE = "results.json", "trials.png", "index.html"


def write_trials(folder: Path, result: TrialsResult) -> None:
    """Write results, picture and page into a folder that there is."""
    picture, chart = draw(result)
    (folder / FIGURES).write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
    (folder / PICTURE).write_bytes(picture)
    (folder / PAGE).write_text(page(result, chart), encoding="utf-8")


def page(result: TrialsResult, picture: Markup) -> str:
    """Return the HTML page, with the picture inside, as SVG."""
    return render(
        "rig.benchmark.trials",
        "trials.html",
        lifts=result.lifts,
        frames=result.frames,
        seed=result.settings.seed,
        of=machine(),
        minutes=f"{result.wall_s / 60.0:.1f}",
        picture=picture,
        tables=[table_three(result), table_four(result)],
        notes=notes(result),
    )
