"""The page of an estimate for a clip: its curve with states, and frames with the contact."""

from collections.abc import Sequence

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.frames.estimates import EstimatedSeries
from rig.pages.page import render
from rig.report.charts import key, lift_chart
from rig.report.parts import Notice, Table, angle_text, made_text, table_of
from rig.report.strips import FRAMES, Still, TipFrames, caption, draw_contact, still, tip_at_zero
from rig.sessions.records import Lift, lift_of_table
from rig.tactile.angles import FUSED
from rig.tactile.contact.finder import ContactFinder


def estimate_lift(series: EstimatedSeries) -> Lift:
    """Return an estimate as a lift without ground truth and phases."""
    angles = dict.fromkeys((FUSED, ""), series.estimate.angles)
    return lift_of_table(name=series.name, angles=angles, onset_estimate_s=series.figures.slip_s)


def tip_of(series: EstimatedSeries) -> TipFrames:
    found, zero = series.estimate, None
    if found.zero is not None:
        zero = next(iter(_images(series, [found.times.index(found.zero)]).values()), None)
    return tip_at_zero(series.name, series.sign, ContactFinder(series.untouched), zero)


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
        warnings=[Notice("warn", f"{one.name}: {text}", "") for one in of for text in one.warnings],
        key=key(truth=False),
        shown=[_page_values(one) for one in of],
        made=made_text(),
    )


def _table(of: Sequence[EstimatedSeries]) -> Table:
    def last(one: EstimatedSeries, values: str) -> float:
        known = getattr(one.estimate.angles.known, values)
        return float(known[-1]) if one.figures.answered else np.nan

    def time(time_s: float | None) -> str:
        return "none" if time_s is None else f"{time_s:.3f}"

    return table_of(
        of,
        {
            "frames of": lambda one: one.name,
            "frames": lambda one: str(one.figures.frames),
            "answered": lambda one: f"{one.figures.answered / one.figures.frames:.0%}",
            "refused": lambda one: (
                ", ".join(f"{n} {s.replace('_', ' ')}" for s, n in one.figures.refused.items()) or "none"
            ),
            "zero at, s": lambda one: time(one.figures.reference_time_s),
            "last angle": lambda one: angle_text(last(one, "angle_deg")),
            "sigma": lambda one: f"{s:.1f}°" if np.isfinite(s := last(one, "sigma_deg")) else "unknown",
            "slip alarm, s": lambda one: time(one.figures.slip_s),
        },
        text=(0, 3),
    )


def _page_values(series: EstimatedSeries) -> dict[str, object]:
    where = f"0 degrees is {series.figures.reference}; angles from {series.angles_from}"
    return {
        "chart": lift_chart(estimate_lift(series), where),
        "strips": {"": _stills(series)},
        "problem": None,
    }


def _stills(series: EstimatedSeries) -> list[Still]:
    """Draw frames evenly spread over the answered ones, over all if none is answered."""
    estimate, tip = series.estimate, tip_of(series)
    angles = np.array([sample.angle_deg for sample in estimate.samples], float)  # None becomes NaN
    known = np.flatnonzero(np.isfinite(angles))
    known = known if known.size else np.arange(angles.size)
    wanted = known[np.unique(np.linspace(0, known.size - 1, FRAMES).round().astype(int))].tolist()
    stills = []
    for place, image in _images(series, wanted).items():
        angle, time_s = float(angles[place]), estimate.times[place].time_ns / NS_PER_S
        stills.append(still(draw_contact(image, tip, angle, np.nan), caption(time_s, angle)))
    return stills


def _images(series: EstimatedSeries, wanted: Sequence[int]) -> dict[int, Image]:
    return {
        place: frame.image
        for place, frame in enumerate(series.frames)
        if place in wanted and frame.image is not None
    }
