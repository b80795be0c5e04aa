"""The page of `rig benchmark clips`: each clip's curve, sigma band, labels and frames, worst first."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivers.types import Image
from rig.benchmark.clips.runs import ClipRun
from rig.benchmark.clips.scores import JudgedLabel
from rig.benchmark.harness import Table, machine
from rig.pages.figure import band, drawing, legend_above, limits, svg
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, SERIES, TRUTH
from rig.report.strips import Still, still

SIGMAS = 2.0
CHART_PX = (440, 260)
STILL_WIDTH_PX, JPEG_QUALITY = 160, 80
_ROOM, _LEAST_ROOM_DEG = 0.06, 1.0
_STYLES = ("-", "--", ":", "-.")
"""Line styles: estimators that share a colour differ in style."""
_BEFORE, _AFTER = 10, 5
"""Frames shown before the reference and after the last label."""


def page(title: str, runs: Mapping[str, Sequence[ClipRun]], verdict: str, tables: Sequence[Table]) -> str:
    """Return the HTML page. runs: by estimator, all in the same order of clips."""
    clips = sorted(zip(*runs.values(), strict=True), key=lambda of: -of[0].score.mean_deg)
    return render(
        "rig.benchmark.clips",
        "clips.html",
        folder=title,
        of=machine(),
        verdict=verdict,
        tables=tables,
        clips=[_clip([*runs], of) for of in clips],
    )


def _clip(names: Sequence[str], runs: Sequence[ClipRun]) -> dict[str, object]:
    first, found = runs[0], runs[0].score
    return {
        "name": first.clip.name,
        "group": first.clip.group,
        "figure": chart(names, runs),
        "stills": stills(first),
        "caption": f"{names[0]}: mean error {found.mean_deg:.1f} degrees, {found.within} within limits, "
        f"0 degrees is {first.estimate.zero_note}",
    }


def chart(names: Sequence[str], runs: Sequence[ClipRun]) -> Markup:
    """Draw a clip as SVG."""
    with drawing(CHART_PX[1], CHART_PX[0]) as figure:
        draw_clip(figure, names, runs)
        return svg(figure, f"{runs[0].clip.name}: angles over frames, with the labels")


def draw_clip(figure: Figure, names: Sequence[str], runs: Sequence[ClipRun]) -> Axes:
    """Draw the labels and the first estimator's angle with two sigma, and the angles of the others thinner.

    All labels and angles are inside the axes. Only the band of a large sigma is clipped, so that it does not
    compress the curves.
    """
    axes = figure.add_subplot()
    first = runs[0]
    labelled = [judged.label for judged in first.labels]
    frames = np.array([label.frame for label in labelled])
    angles = np.array([label.angle_deg for label in labelled])
    errors = SIGMAS * np.array([label.sigma_deg for label in labelled])
    shown = np.arange(
        max(first.clip.reference_frame - _BEFORE, 0),
        min(max(frames) + _AFTER + 1, len(first.estimate.samples)),
    )
    curves = [run.estimate.angles.angle_deg[shown] for run in runs]
    axes.set_xlim(shown[0] - 0.5, shown[-1] + 0.5)
    axes.set_ylim(limits(*curves, angles - errors, angles + errors, room=_ROOM, least=_LEAST_ROOM_DEG))
    if first.has_sigma:
        spread = SIGMAS * np.nan_to_num(first.estimate.angles.sigma_deg[shown])
        band(axes, shown, curves[0], spread, ESTIMATE.light)
    colours = (ESTIMATE, *SERIES)
    for number, (name, curve) in enumerate(zip(names, curves, strict=True)):
        again, place = divmod(number, len(colours))
        colour, style = colours[place].light, _STYLES[again % len(_STYLES)]
        axes.plot(shown, curve, style, color=colour, linewidth=0.9 if number else 1.8, label=name)
    axes.errorbar(frames, angles, errors, fmt="o", color=TRUTH.light, markersize=4, label="measured by hand")
    axes.set(xlabel="frame", ylabel="angle, degrees")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    legend_above(axes, 4)
    return axes


def stills(run: ClipRun) -> list[Still]:
    """Return the reference frame and the labelled frames as small images."""
    wanted: dict[int, str] = {run.clip.reference_frame: "reference"}
    wanted |= {judged.label.frame: _caption(judged) for judged in run.labels}
    return [
        still(_small(frame.image), f"frame {number}: {wanted[number]}")
        for number, frame in enumerate(run.clip.series)
        if number in wanted and frame.image is not None
    ]


def _caption(judged: JudgedLabel) -> str:
    sigma = "" if judged.sigma_deg is None else f" ± {judged.sigma_deg:.1f}"
    answer = "refused" if judged.angle_deg is None else f"{judged.angle_deg:+.1f}{sigma}"
    return f"{judged.label.angle_deg:+.1f} ± {judged.label.sigma_deg:.1f} measured, {answer} answered"


def _small(image: Image) -> Image:
    height = round(image.shape[0] * STILL_WIDTH_PX / image.shape[1])
    return np.asarray(cv2.resize(image, (STILL_WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
