"""One HTML page per calibration that needs nothing else: verdict, numbers, pictures, rejected samples."""

import base64
from importlib.resources import files

from jinja2 import Environment

from calibration.store import CalibrationFile
from rig.calibrate.outcome import Outcome


def page_html(outcome: Outcome, filed: CalibrationFile) -> str:
    """The page of an outcome; a picture is inside it as data."""
    text = files("rig.calibrate").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True)
    environment.filters["data"] = lambda png: "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    return environment.from_string(text).render(
        outcome=outcome,
        created=filed.created,
        verdict=str(outcome.judgement.verdict),
        software=", ".join(f"{name} {number}" for name, number in filed.software.items()),
        inputs=filed.inputs,
    )
