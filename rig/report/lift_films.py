"""Films of a page's lifts. They are made last, so that page and films together stay below the size limit."""

import re

from jinja2.utils import htmlsafe_json_dumps

from rig.report.explored import lift_film
from rig.report.lift_rows import anchor
from rig.report.session import UNREADABLE, Trial
from rig.sessions.records import Lift

MOST_BYTES, LEAST_FILM_BYTES = 5_900_000, 6_000
"""Size limit of a page, and least size reserved for a film, even if the page then exceeds its limit."""


def film_mark(lift: Lift) -> str:
    """Return the placeholder of a lift's film in the page's data."""
    return f"film of {anchor(lift)}"


def with_films(page: str, trial: Trial) -> str:
    """Return a trial's page with films in place of the placeholders, as large as the size limit allows."""
    marks = {f'"film":"{film_mark(lift)}"': lift for lift in trial.lifts}
    marks = {mark: lift for mark, lift in marks.items() if mark in page}
    room = (MOST_BYTES - len(page.encode())) // max(len(marks), 1)
    most_bytes = max(room * 3 // 4, LEAST_FILM_BYTES)  # base64 adds a third
    films = {mark: htmlsafe_json_dumps(_film_of(trial, lift, most_bytes)) for mark, lift in marks.items()}
    # in one pass, so that a placeholder inside a film's data is not replaced
    pattern = "|".join(map(re.escape, films)) or "(?!)"
    return re.sub(pattern, lambda found: f'"film":{films[found.group()]}', page)


def _film_of(trial: Trial, lift: Lift, most_bytes: int) -> dict[str, object] | None:
    if lift.curves is None:
        return None
    path = trial.folder / lift.recording
    try:
        return lift_film(path, lift.curves, lift.zero_ns, trial.manifest, most_bytes)
    except UNREADABLE:  # the page has a notice about the damaged recording
        return None
