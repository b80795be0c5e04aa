"""One HTML page per calibration that needs nothing else: verdict, numbers, pictures, rejected samples."""

from calibration.store import CalibrationFile
from rig.calibrate.outcome import Outcome
from rig.pages.page import render


def page_html(outcome: Outcome, filed: CalibrationFile) -> str:
    """The page of an outcome; a picture is inside it as data."""
    return render(
        "rig.calibrate",
        "page.html",
        outcome=outcome,
        created=filed.created,
        verdict=str(outcome.judgement.verdict),
        software=", ".join(f"{name} {number}" for name, number in filed.software.items()),
        inputs=filed.inputs,
    )
