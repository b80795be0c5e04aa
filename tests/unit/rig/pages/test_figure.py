"""Charts: nothing is drawn outside the axes, and names in any script cause no warnings."""

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from rig.benchmark.clips.study import draw_clip
from rig.pages.figure import drawing, svg
from rig.report.charts import draw_lift
from rig.sessions.records import lift_of_table
from rig.tactile.angles import FUSED, MARKERS, Angles

ANGLES = st.lists(st.floats(-180.0, 180.0) | st.just(float("nan")), min_size=40, max_size=40).map(np.array)
SIGMAS = st.lists(st.floats(0.0, 90.0) | st.just(float("nan")), min_size=40, max_size=40).map(np.array)
TIMES = np.linspace(-1.0, 3.0, 40)
SLACK = 1e-6


def outside(axes: Axes) -> list[str]:
    """Return the artists in data coordinates that have a vertex outside the axes limits."""
    drawn = {f"line {line.get_label()}": [line.get_xydata()] for line in axes.lines
             if line.get_transform() == axes.transData}  # fmt: skip
    for number, part in enumerate(axes.collections):
        lines = part.get_segments() if isinstance(part, LineCollection) else None
        drawn[f"{type(part).__name__} {number}"] = lines or [p.vertices for p in part.get_paths()]
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
    found = []
    for name, parts in drawn.items():
        points = np.concatenate([np.reshape(part, (-1, 2)) for part in parts] or [np.zeros((0, 2))])
        points = points[np.isfinite(points).all(axis=1)]
        if ((points < low - SLACK) | (points > high + SLACK)).any():
            found.append(name)
    return found


@pytest.mark.heavy
@settings(deadline=None, max_examples=12)
@given(ANGLES, SIGMAS, ANGLES, ANGLES)
def test_lift_chart_stays_inside_its_axes(estimate: Any, sigma: Any, truth: Any, tip: Any) -> None:
    angles = {FUSED: Angles(TIMES, estimate, sigma), MARKERS: Angles(TIMES, truth), "T1": Angles(TIMES, tip)}
    lift = lift_of_table(phases_s={"A": -0.8, "B": 0.0, "C": 1.5, "lower": 2.5}, angles=angles)
    with drawing(230, arranged=False) as figure:
        assert outside(draw_lift(figure, lift)) == []


@pytest.mark.heavy
@settings(deadline=None, max_examples=12)
@given(ANGLES, SIGMAS, ANGLES, st.lists(st.floats(-180, 180), min_size=3, max_size=3), st.floats(0.0, 20.0))
def test_clip_chart_stays_inside_its_axes(
    first: Any, sigma: Any, second: Any, labels: list[float], label_sigma: float
) -> None:
    runs: list[Any] = [_run(angles, sigma, labels, label_sigma) for angles in (first, second)]
    with drawing(260, 440) as figure:
        axes = draw_clip(figure, ["slip", "ecc"], runs)
        assert outside(axes) == []


def _run(angles: Any, sigma: Any, labels: list[float], label_sigma: float) -> Any:
    marked = [
        SimpleNamespace(label=SimpleNamespace(frame=frame, angle_deg=angle, sigma_deg=label_sigma))
        for frame, angle in zip((12, 20, 38), labels, strict=True)
    ]
    series = Angles(np.arange(len(angles)) / 60.0, angles, sigma)
    estimate = SimpleNamespace(samples=series.time_s, angles=series)
    clip = SimpleNamespace(reference_frame=4)
    answers = SimpleNamespace(labels=marked, has_sigma=True)
    return SimpleNamespace(clip=clip, estimate=estimate, answers=answers)


@pytest.mark.parametrize("name", ["測定", "القياس", "\u001b[2J"])
def test_name_in_another_script_causes_no_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with drawing(100) as figure:
            figure.subplots().set_xlabel(name)
            svg(figure, "a chart")
