"""Films of a page's lifts, made last: they get the room that the rest of the page leaves."""

import re

from jinja2.utils import htmlsafe_json_dumps

from rig.report.explored import lift_film
from rig.report.lift_rows import anchor
from rig.report.session import UNREADABLE, Lift, Trial

MOST_BYTES, LEAST_FILM_BYTES = 5_900_000, 6_000
"""Of a page, if the least films leave room for the rest, and the room of one film at least."""


def film_mark(lift: Lift) -> str:
    """Return what stands in the page's data in place of a lift's film until the rest of the page is known."""
    return f"film of {anchor(lift)}"


def with_films(page: str, trial: Trial) -> str:
    """Return a trial's page with films in place of their marks, as large as the page may still grow."""
    marks = {f'"film":"{film_mark(lift)}"': lift for lift in trial.lifts}
    marks = {mark: lift for mark, lift in marks.items() if mark in page}
    room = (MOST_BYTES - len(page.encode())) // max(len(marks), 1)
    most_bytes = max(room * 3 // 4, LEAST_FILM_BYTES)  # base64 adds a third
    films = {mark: htmlsafe_json_dumps(_film_of(trial, lift, most_bytes)) for mark, lift in marks.items()}
    # one pass: a mark in a film's own text stays as it is
    pattern = "|".join(map(re.escape, films)) or "(?!)"
    return re.sub(pattern, lambda found: f'"film":{films[found.group()]}', page)


def _film_of(trial: Trial, lift: Lift, most_bytes: int) -> dict[str, object] | None:
    if lift.curves is None:
        return None
    path = trial.folder / lift.row.recording
    try:
        return lift_film(path, lift.curves, lift.zero_ns, trial.manifest, most_bytes)
    except UNREADABLE:  # the recording's damage is named above
        return None
