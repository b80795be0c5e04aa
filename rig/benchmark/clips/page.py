"""The page of `rig benchmark clips`: each clip's curve, sigma band, labels and frames, worst first."""

from collections.abc import Sequence

import cv2
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from drivers.types import Image
from rig.benchmark.clips.benchmark import ClipRun, ClipsResult
from rig.benchmark.clips.scores import JudgedLabel
from rig.benchmark.clips.tables import clip_table, limit_table, overall_table, verdict
from rig.benchmark.estimators.benchmark import machine
from rig.pages.figure import drawing, legend_above, svg
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, SERIES, TRUTH
from rig.report.strips import Still, still

SIGMAS = 2.0
CHART_PX = (440, 260)
STILL_WIDTH_PX, JPEG_QUALITY = 160, 80
_ROOM = 0.15
"""Of the labels' range, left above and below them: a sigma of 30 degrees does not shrink the curve."""


def page(result: ClipsResult) -> str:
    """Return the HTML page."""
    clips = sorted(
        zip(*(of.runs for of in result.estimators), strict=True), key=lambda runs: -runs[0].score.mean_deg
    )
    return render(
        "rig.benchmark.clips",
        "clips.html",
        folder=result.folder.name,
        of=machine(),
        verdict=verdict(result.limits),
        tables=[*([limit_table(result)] if result.limits else []), overall_table(result), clip_table(result)],
        clips=[_clip(result, runs) for runs in clips],
    )


def _clip(result: ClipsResult, runs: Sequence[ClipRun]) -> dict[str, object]:
    first, score = runs[0], runs[0].score
    names = [of.name for of in result.estimators]
    return {
        "name": first.clip.name,
        "group": first.clip.group,
        "figure": chart(names, runs),
        "stills": stills(first),
        "caption": f"{names[0]}: mean error {score.mean_deg:.1f} degrees, {score.within:.0%} within limits, "
        f"zero: {first.estimate.zero_note}",
    }


def chart(names: Sequence[str], runs: Sequence[ClipRun]) -> Markup:
    """Draw a clip: labels with two sigma, the first estimator's angle with two sigma, the others thinner."""
    with drawing(CHART_PX[1], CHART_PX[0]) as figure:
        axes = figure.add_subplot()
        for name, run, colour in zip(names, runs, (ESTIMATE, *(SERIES * len(runs))), strict=False):
            _curve(axes, name, run, colour.light, run is runs[0])
        _labels(axes, runs[0])
        axes.set(xlabel="frame", ylabel="angle, degrees")
        legend_above(axes, 4)
        return svg(figure, f"{runs[0].clip.name}: angles over frames, with the labels")


def stills(run: ClipRun) -> list[Still]:
    """Return the reference and the labelled frames as small pictures."""
    wanted: dict[int, str] = {run.clip.reference_frame: "reference"}
    wanted |= {judged.label.frame: _told(judged) for judged in run.labels}
    return [
        still(_small(frame.image), f"frame {number}: {wanted[number]}")
        for number, frame in enumerate(run.clip.series)
        if number in wanted and frame.image is not None
    ]


def _curve(axes: Axes, name: str, run: ClipRun, colour: str, first: bool) -> None:
    angles, sigmas = (
        np.array([np.nan if value is None else value for value in values])
        for values in (run.estimate.angles_deg, run.estimate.sigmas_deg)
    )
    frames = np.arange(len(angles))
    if first and run.has_sigma:
        spread = SIGMAS * np.nan_to_num(sigmas)
        axes.fill_between(frames, angles - spread, angles + spread, color=colour, alpha=0.22, linewidth=0)
    axes.plot(frames, angles, color=colour, linewidth=1.8 if first else 0.9, label=name)


def _labels(axes: Axes, run: ClipRun) -> None:
    frames = [judged.label.frame for judged in run.labels]
    angles = [judged.label.angle_deg for judged in run.labels]
    errors = [SIGMAS * judged.label.sigma_deg for judged in run.labels]
    axes.errorbar(frames, angles, errors, fmt="o", color=TRUTH.light, markersize=4, label="measured by hand")
    low, high = min(0.0, *angles), max(0.0, *angles)
    room = max(_ROOM * (high - low), 3.0)
    axes.set_ylim(low - room, high + room)
    axes.set_xlim(run.clip.reference_frame - 10, max(frames) + 5)


def _told(judged: JudgedLabel) -> str:
    sigma = "" if judged.sigma_deg is None else f" ± {judged.sigma_deg:.1f}"
    answer = "refused" if judged.angle_deg is None else f"{judged.angle_deg:+.1f}{sigma}"
    return f"{judged.label.angle_deg:+.1f} ± {judged.label.sigma_deg:.1f} measured, {answer} answered"


def _small(image: Image) -> Image:
    height = round(image.shape[0] * STILL_WIDTH_PX / image.shape[1])
    return np.asarray(cv2.resize(image, (STILL_WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
