"""Figures of the calibration pages, as PNG."""

import io
from collections.abc import Mapping, Sequence
from itertools import cycle

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from drivers.images import encode_png
from drivers.types import Image
from rig.pages.palette import ESTIMATE, SERIES, WARNING

Array = NDArray[np.floating]

mpl.use("Agg")


def bars(values: Mapping[str, float], label: str, limit: float | None = None) -> bytes:
    """A bar per sample, the ones beyond `limit` in another colour."""
    figure = _figure(3.0)
    axes = figure.subplots()
    names, heights = list(values), list(values.values())
    colours = [(WARNING if limit is not None and h > limit else ESTIMATE).light for h in heights]
    axes.bar(range(len(names)), heights, color=colours)
    step = max(1, len(names) // 25)
    axes.set_xticks(range(0, len(names), step), names[::step], rotation=60, ha="right", fontsize=7)
    axes.set_ylabel(label)
    return _png(figure)


def field(values: Array, size: tuple[int, int], label: str, points: Array | None = None) -> bytes:
    """A number over the picture, and the corners seen on top of it."""
    figure = _figure(4.6)
    axes = figure.subplots()
    shown = axes.imshow(
        values, extent=(0, size[0], size[1], 0), interpolation="bilinear", cmap="viridis", aspect="equal"
    )
    figure.colorbar(shown, ax=axes, label=label, shrink=0.85)
    if points is not None:
        axes.plot(points[:, 0], points[:, 1], ".", color="white", markersize=1.5, alpha=0.6)
    axes.set_xlim(0, size[0])
    axes.set_ylim(size[1], 0)
    return _png(figure)


def arrows(places: Array, vectors: Array, size: tuple[int, int], label: str) -> bytes:
    """Vectors over the picture, enlarged so that they can be seen."""
    figure = _figure(4.6)
    axes = figure.subplots()
    lengths = np.linalg.norm(vectors, axis=1)
    typical = max(float(np.percentile(lengths, 90)), 1e-9)
    scale = 0.05 * size[0] / typical
    axes.quiver(
        places[:, 0],
        places[:, 1],
        vectors[:, 0] * scale,
        vectors[:, 1] * scale,
        lengths,
        angles="xy",
        scale_units="xy",
        scale=1,
        cmap="viridis",
        width=0.002,
    )
    axes.set_xlim(0, size[0])
    axes.set_ylim(size[1], 0)
    axes.set_aspect("equal")
    axes.set_title(f"{label} (enlarged {scale:.0f} times)", fontsize=10)
    return _png(figure)


def lines(
    series: Mapping[str, tuple[Array, Array]], x_label: str, y_label: str, marks: bool = False
) -> bytes:
    """Curves over one axis."""
    figure = _figure(3.4)
    axes = figure.subplots()
    for (name, (x, y)), colour in zip(series.items(), cycle(SERIES), strict=False):
        axes.plot(x, y, "o-" if marks else "-", label=name, markersize=3.5, linewidth=1.2, color=colour.light)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    if len(series) > 1:
        axes.legend(frameon=False)
    return _png(figure)


def scatter(groups: Mapping[str, tuple[Array, Array]], x_label: str, y_label: str) -> bytes:
    """Points of several groups, axes equal."""
    figure = _figure(4.2)
    axes = figure.subplots()
    for (name, (x, y)), colour in zip(groups.items(), cycle(SERIES), strict=False):
        axes.plot(x, y, ".", label=name, markersize=4, color=colour.light)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_aspect("equal", adjustable="datalim")
    if len(groups) > 1:
        axes.legend(frameon=False)
    return _png(figure)


def thumbnail(picture: Image, marks: Sequence[Array] = ()) -> bytes:
    """A small picture, (H, W) or (H, W, 3) RGB, with points marked."""
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB) if picture.ndim == 2 else picture.copy()
    for points in marks:
        for x, y in np.asarray(points, int):
            cv2.circle(colour, (int(x), int(y)), 4, (255, 120, 0), 2)
    scale = 320.0 / colour.shape[1]
    small = cv2.resize(np.asarray(colour, np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return encode_png(np.asarray(small, np.uint8))


def _figure(height: float) -> Figure:
    return Figure(figsize=(8.0, height), dpi=110, layout="constrained")


def _png(figure: Figure) -> bytes:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
