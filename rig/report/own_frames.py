"""The page of an estimate for a clip: its curve with states, and frames with the contact."""

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.frames.estimation import EstimatedSeries
from rig.pages.page import render
from rig.report.curves import Curve, LiftCurves
from rig.report.lift_chart import key, lift_chart
from rig.report.parts import Notice, Table
from rig.report.strips import FRAMES, Still, TipFrames, caption, drawn, still, tip_at_zero
from rig.report.text import angle_text, made_text
from rig.tactile.contact.finder import ContactFinder


def estimate_curves(series: EstimatedSeries) -> LiftCurves:
    """Return an estimate as the curves of a lift without ground truth and phases."""
    found, unknown = series.done.estimate, np.empty(0)
    curve = Curve(
        np.array([answer.time.time_ns / NS_PER_S for answer in found.answers]),
        np.array(found.angles_deg, float),  # None becomes nan
        np.array(found.sigmas_deg, float),
        tuple(answer.sample.state.value for answer in found.answers),
    )
    return LiftCurves(
        series.name,
        curve,
        Curve(unknown, unknown, unknown),
        onset_estimate_s=series.done.figures.slip_s,
        tips={series.name: curve},
        time_label="time, s",
    )


def tip_of(series: EstimatedSeries) -> TipFrames:
    """Return the data that are drawn into the frames of a series."""
    found = series.done.estimate
    zero = None if found.zero is None else [answer.time for answer in found.answers].index(found.zero)
    finder = ContactFinder(series.done.untouched)
    return tip_at_zero(series.name, series.sign, finder, _images(series, [zero]).get(zero))


def estimate_page(of: Sequence[EstimatedSeries], source: str, about: str, simulated: bool = False) -> str:
    """Return one HTML page of the estimates of a clip, or of a recording's sensors.

    source: name of the file or folder. about: estimator and background, in words.
    """
    return render(
        "rig.report",
        "own_frames.html",
        source=source,
        about=about,
        simulated=simulated,
        figures=_table(of),
        warnings=[Notice("warn", f"{one.name}: {text}", "") for one in of for text in one.done.warnings],
        key=key(truth=False),
        shown=[_shown(one) for one in of],
        made=made_text(datetime.now(UTC)),
    )


def _table(of: Sequence[EstimatedSeries]) -> Table:
    columns = (
        "frames of",
        "frames",
        "answered",
        "refused",
        "zero at, s",
        "last angle",
        "sigma",
        "slip alarm, s",
    )
    rows = []
    for one in of:
        found, last = one.done.figures, estimate_curves(one).estimate.answered
        refused = ", ".join(f"{count} {state}" for state, count in found.refused.items()) or "none"
        angle, sigma = (
            (float(last.angle_deg[-1]), float(last.sigma_deg[-1])) if found.answered else (None, np.nan)
        )
        rows.append(
            [
                one.name,
                str(found.frames),
                f"{found.answered / found.frames:.0%}",
                refused,
                "none" if found.reference_time_s is None else f"{found.reference_time_s:.3f}",
                angle_text(angle),
                f"{sigma:.1f}°" if np.isfinite(sigma) else "unknown",
                "none" if found.slip_s is None else f"{found.slip_s:.3f}",
            ]
        )
    return Table(columns, rows, text=(0, 3))


def _shown(series: EstimatedSeries) -> dict[str, object]:
    curves = estimate_curves(series)
    where = f"0 degrees is {series.done.figures.reference}; angles from {series.done.angles_from}"
    return {"chart": lift_chart(curves, where), "strips": {"": _stills(series, curves)}, "problem": None}


def _stills(series: EstimatedSeries, curves: LiftCurves) -> list[Still]:
    """Draw frames evenly spread over the answered ones, over all if none is answered."""
    curve, tip = curves.estimate, tip_of(series)
    known = np.flatnonzero(np.isfinite(curve.angle_deg))
    known = known if known.size else np.arange(curve.time_s.size)
    wanted = known[np.unique(np.linspace(0, known.size - 1, FRAMES).round().astype(int))].tolist()
    stills = []
    for place, image in _images(series, wanted).items():
        angle = float(curve.angle_deg[place])
        stills.append(still(drawn(image, tip, angle, np.nan), caption(float(curve.time_s[place]), angle)))
    return stills


def _images(series: EstimatedSeries, wanted: Sequence[int | None]) -> dict[int | None, Image]:
    return {
        place: frame.image
        for place, frame in enumerate(series.frames)
        if place in wanted and frame.image is not None
    }
