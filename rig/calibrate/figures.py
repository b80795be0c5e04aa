"""Figures of the calibration pages, SVG in the page's own colours; and sheets to print, as PDF."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import cycle
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calibration.targets.sheets import TEXT_MM, target_sheet
from drivers.images import encode_png
from drivers.types import Image, Pose
from rig.pages.figure import drawing, legend_above, svg
from rig.pages.palette import ESTIMATE, INK, SERIES, WARNING

Array = NDArray[np.floating]
_WIDTH_PX = 440
_MM_PER_INCH = 25.4
_POINTS_PER_INCH = 72.0
_MOST_POSES = 60
_MOST_NAMES = 14
"""Names below an axis that a phone still shows apart."""


def bars(values: Mapping[str, float], label: str, limit: float | None = None) -> Markup:
    """A bar per sample, the ones above `limit` in another colour."""
    names, heights = list(values), list(values.values())
    beyond = [limit is not None and height > limit for height in heights]
    with drawing(260, _WIDTH_PX) as figure:
        axes = figure.subplots()
        axes.bar(range(len(names)), heights, color=[(WARNING if far else ESTIMATE).light for far in beyond])
        step = -(-len(names) // _MOST_NAMES)
        axes.set_xticks(range(0, len(names), step), names[::step], rotation=90)
        axes.set_ylabel(label)
        axes.grid(False, axis="x")
        if limit:
            axes.axhline(limit, color=INK.light, linewidth=1.0, linestyle=(0, (4, 2)))
        return svg(figure, f"bars: {label}")


def field(values: Array, size: tuple[int, int], label: str, points: Array | None = None) -> Markup:
    """A number over the picture, and the corners seen on top of it."""
    with drawing(330, _WIDTH_PX) as figure:
        axes = figure.subplots()
        shown = axes.imshow(
            values, extent=(0, size[0], size[1], 0), interpolation="bilinear", cmap="viridis", aspect="equal"
        )
        figure.colorbar(shown, ax=axes, label=label, shrink=0.85)
        if points is not None:
            axes.plot(points[:, 0], points[:, 1], ".", color="white", markersize=1.5, alpha=0.6)
        axes.grid(False)
        _over_picture(axes, size)
        return svg(figure, f"over the picture: {label}")


def arrows(places: Array, vectors: Array, size: tuple[int, int], label: str) -> Markup:
    """Vectors over the picture, enlarged so that they can be seen."""
    lengths = np.linalg.norm(vectors, axis=1)
    typical = max(float(np.percentile(lengths, 90)), 1e-9)
    scale = 0.05 * size[0] / typical
    with drawing(330, _WIDTH_PX) as figure:
        axes = figure.subplots()
        axes.quiver(
            *places.T, *(vectors.T * scale), angles="xy", scale_units="xy", scale=1, color=ESTIMATE.light,
            width=0.003,
        )  # fmt: skip
        axes.set_aspect("equal")
        _over_picture(axes, size)
        axes.set_title(f"{label} (enlarged {scale:.0f} times)")
        return svg(figure, f"arrows: {label}")


def curves(groups: Mapping[str, tuple[Array, Array]], x_label: str, y_label: str, style: str = "-") -> Markup:
    """Curves of several groups over one axis; with style "." points in a plane, its axes equal."""
    points = style == "."
    with drawing(330 if points else 280, _WIDTH_PX) as figure:
        axes = figure.subplots()
        for (name, (x, y)), colour in zip(groups.items(), cycle(SERIES), strict=False):
            size = 4.0 if points else 3.5
            axes.plot(x, y, style, label=name, markersize=size, linewidth=1.2, color=colour.light)
        axes.set(xlabel=x_label, ylabel=y_label)
        if points:
            axes.set_aspect("equal", adjustable="datalim")
        if len(groups) > 1:
            legend_above(axes, 2)
        return svg(figure, f"{y_label} over {x_label}: {', '.join(groups)}")


def poses(groups: Mapping[str, Sequence[Pose]]) -> Markup:
    """Poses of several groups in 3D, in one parent frame: a dot each, with its x, y and z axes.

    The z axis is the longest line, so that the direction in which a camera looks or a tool points is seen.
    """
    groups = {name: group[:: -(-len(group) // _MOST_POSES)] for name, group in groups.items() if group}
    places = {name: np.array([pose.position_m for pose in group]) for name, group in groups.items()}
    everywhere = np.vstack(list(places.values()))
    middle = (everywhere.max(axis=0) + everywhere.min(axis=0)) / 2
    half = 0.6 * max(float(np.ptp(everywhere, axis=0).max()), 0.05)
    length = 0.13 * half
    with drawing(400, _WIDTH_PX, arranged=False) as figure:
        axes: Any = figure.add_axes((0.0, 0.05, 0.9, 0.87), projection="3d")
        for (name, at), colour in zip(places.items(), cycle(SERIES), strict=False):
            axes.plot(*at.T, "o", markersize=3.0, label=name, color=colour.light)
            turns = np.array([pose.rotation.as_matrix() for pose in groups[name]])
            ends = at[:, None] + np.swapaxes(turns, 1, 2) * (length * np.array([[0.6], [0.6], [1.6]]))
            gap = np.full_like(ends, np.nan)
            lines = np.stack([np.broadcast_to(at[:, None], ends.shape), ends, gap], axis=2).reshape(-1, 3)
            axes.plot(*lines.T, linewidth=0.9, color=colour.light)
        for name in "xyz":
            getattr(axes, f"set_{name}label")(f"{name}, m", labelpad=4)
        axes.set_box_aspect((1.0, 1.0, 1.0))
        axes.tick_params(labelsize=10, pad=0)
        for axis, centre in zip((axes.xaxis, axes.yaxis, axes.zaxis), middle, strict=True):
            axis.set_view_interval(centre - half, centre + half, ignore=True)
            axis.set_pane_color((0.0, 0.0, 0.0, 0.0))
            axis.set_major_locator(MaxNLocator(3))
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.08), ncols=len(places), columnspacing=1.1)
        return svg(figure, f"poses in 3D: {', '.join(places)}")


def _over_picture(axes: Axes, size: tuple[int, int]) -> None:
    axes.set(xlim=(0, size[0]), ylim=(size[1], 0), xlabel="x, px", ylabel="y, px")


def thumbnail(picture: Image, marks: Sequence[Array] = ()) -> bytes:
    """A small picture, (H, W) or (H, W, 3) RGB, with points marked."""
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB) if picture.ndim == 2 else picture.copy()
    for points in marks:
        for x, y in np.asarray(points, int):
            cv2.circle(colour, (int(x), int(y)), 4, (255, 120, 0), 2)
    scale = 320.0 / colour.shape[1]
    small = cv2.resize(np.asarray(colour, np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return encode_png(np.asarray(small, np.uint8))


def sheet_pdf(spec: str) -> bytes:
    """The sheet of a target. Raises `InputError` for a target that is not understood."""
    sheet = target_sheet(spec)
    wide, high = sheet.size_mm
    figure = Figure(figsize=(wide / _MM_PER_INCH, high / _MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, wide), ylim=(high, 0.0))
    axes.axis("off")
    corners = [[(x, y), (x + w, y), (x + w, y + h), (x, y + h)] for x, y, w, h in sheet.ink]
    axes.add_collection(PolyCollection(corners, facecolors="black", linewidths=0.0))
    size = TEXT_MM / _MM_PER_INCH * _POINTS_PER_INCH
    axes.text(*sheet.text_mm, sheet.text, fontsize=size, family="sans-serif", va="baseline")
    stream = BytesIO()
    # without a date, so that equal targets give equal files
    figure.savefig(stream, format="pdf", metadata={"Title": spec, "CreationDate": None})
    return stream.getvalue()
