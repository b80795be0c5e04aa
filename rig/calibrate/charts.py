"""Figures of the calibration pages, SVG in the page's own colours; and sheets to print, as PDF."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calibration.targets.boards import View
from calibration.targets.sheets import TEXT_MM, target_sheet
from calibration.verdict import Rejected
from drivers.images import encode_png, read_image
from drivers.types import Image, Pose
from rig.pages.figure import drawing, legend_above, svg
from rig.pages.page import data_uri
from rig.pages.palette import ESTIMATE, INK, LINE, SERIES, WARNING

Array = NDArray[np.floating]
_WIDTH_PX = 440
_MM_PER_INCH = 25.4
_POINTS_PER_INCH = 72.0
_MOST_POSES = 60
_TURN_RAD, _TILT_RAD = -1.05, 0.52
"""First view of poses in 3D: about the vertical axis, and from above."""
_AXIS, _LENGTHS = 0.06, np.array([0.6, 0.6, 1.6])
"""Length of drawn axes as a share of the shown box's diagonal, and of x, y and z in it."""
_ON_PICTURE = "#ffd400"
"""Colour of arrows on a grey picture: seen on dark and on bright parts."""
_MOST_NAMES = 14
"""Names below an axis that a phone still shows apart."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page, drawn by the macro `chart` of `rig/pages/parts.html`.

    svg: the SVG element, or another element of the page. spots: values shown under the pointer; these figures
    have none.
    """

    title: str
    caption: str
    svg: Markup
    spots: tuple[()] = ()


def bars(
    title: str, caption: str, values: Mapping[str, float], label: str, limit: float | None = None
) -> Picture:
    """Draw a bar per sample, the ones above `limit` in another colour."""
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
        return Picture(title, caption, svg(figure, f"bars: {label}"))


def field(
    title: str, caption: str, values: Array, size: tuple[int, int], label: str, points: Array | None = None
) -> Picture:
    """Draw a number over the picture, and the corners seen on top of it."""
    with drawing(330, _WIDTH_PX) as figure:
        axes = figure.subplots()
        shown = axes.imshow(
            values, extent=(0, size[0], size[1], 0), interpolation="bilinear", cmap="viridis", aspect="equal"
        )
        figure.colorbar(shown, ax=axes, label=label, shrink=0.85)
        if points is not None:
            axes.plot(points[:, 0], points[:, 1], ".", color="white", markersize=1.5, alpha=0.6)
        axes.grid(False)
        axes.set(xlim=(0, size[0]), ylim=(size[1], 0), xlabel="x, px", ylabel="y, px")
        return Picture(title, caption, svg(figure, f"over the picture: {label}"))


def residuals(
    title: str,
    caption: str,
    places: Array,
    vectors: Array,
    size: tuple[int, int],
    picture: Image | None = None,
) -> Picture:
    """Draw residuals as arrows over the picture, enlarged so that they can be seen.

    picture: (H, W) grey, drawn below them as far as they reach, with a margin.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    typical = max(float(np.percentile(lengths, 90)), 1e-9)
    margin = 0.25 * float(np.ptp(places, axis=0).max()) if picture is not None else max(size)
    left, top = np.maximum(places.min(axis=0) - margin, 0).astype(int)
    right, bottom = np.minimum(places.max(axis=0) + margin, size).astype(int)
    scale = 0.08 * float(right - left) / typical
    with drawing(330, _WIDTH_PX) as figure:
        axes = figure.subplots()
        extent = (left, right, bottom, top)
        if picture is not None:
            part = picture[top:bottom, left:right]
            axes.imshow(part, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none")
            axes.grid(False)
        axes.quiver(
            *places.T, *(vectors.T * scale), angles="xy", scale_units="xy", scale=1, width=0.004,
            color=ESTIMATE.light if picture is None else _ON_PICTURE,
        )  # fmt: skip
        axes.set_aspect("equal")
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x, px", ylabel="y, px")
        axes.set_title(f"residuals (enlarged {scale:.0f} times)")
        return Picture(title, caption, svg(figure, "arrows: residuals"))


def curves(
    title: str, caption: str, groups: Mapping[str, tuple[Array, Array]], x: str, y: str, style: str = "-"
) -> Picture:
    """Draw curves of several groups over one axis; with style "." points in a plane, its axes equal."""
    points = style == "."
    with drawing(330 if points else 280, _WIDTH_PX) as figure:
        axes = figure.subplots()
        for (name, values), colour in zip(groups.items(), cycle(SERIES), strict=False):
            size = 4.0 if points else 3.5
            axes.plot(*values, style, label=name, markersize=size, linewidth=1.2, color=colour.light)
        axes.set(xlabel=x, ylabel=y)
        if points:
            axes.set_aspect("equal", adjustable="datalim")
        if len(groups) > 1:
            legend_above(axes, 2)
        return Picture(title, caption, svg(figure, f"{y} over {x}: {', '.join(groups)}"))


def image(title: str, caption: str, picture: Image) -> Picture:
    """Show a small copy of a picture, (H, W, 3) RGB."""
    element = Markup('<img src="{}" alt="{}">').format(data_uri(thumbnail(picture)), title)
    return Picture(title, caption, element)


def poses(caption: str, groups: Mapping[str, Sequence[Pose]]) -> Picture:
    """Draw poses of several groups in 3D, in one parent frame: a dot each, with its x, y and z axes.

    The z axis is the longest line: a camera looks along it, a tool points along it. The figure is the first
    view of `rig/pages/poses.js`, which rotates the poses where JavaScript runs.
    """
    shown = {name: group[:: -(-len(group) // _MOST_POSES)] for name, group in groups.items() if group}
    colours = dict(zip(shown, SERIES, strict=False))
    everywhere = np.array([pose.position_m for group in shown.values() for pose in group])
    lowest, highest = everywhere.min(axis=0), everywhere.max(axis=0)
    across = max(float((highest - lowest).max()), 0.05)
    step = float(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, across)[1])
    low, high = np.floor(lowest / step) * step, np.ceil(highest / step) * step
    length = _AXIS * float(np.linalg.norm(high - low))
    with drawing(400, _WIDTH_PX) as figure:
        axes = figure.subplots()
        axes.axis("off")
        axes.set_aspect("equal")
        for floor in _floor_lines(low, high, step):
            axes.plot(*_flat(floor).T, color=LINE.light, linewidth=0.8)
        for name, group in shown.items():
            lines = [_flat(np.array([pose.position_m, end])) for pose in group for end in _ends(pose, length)]
            axes.add_collection(LineCollection(lines, colors=colours[name].light, linewidths=0.9))
            places = _flat(np.array([pose.position_m for pose in group]))
            axes.plot(*places.T, "o", markersize=3.5, color=colours[name].light)
        axes.text(0.0, 0.0, f"grid: {step:g} m", transform=axes.transAxes)
        drawn = svg(figure, f"poses in 3D: {', '.join(shown)}")

    def pose_values(pose: Pose) -> dict[str, list[Any]]:
        ends = _ends(pose, length)
        return {"at": np.round(pose.position_m, 5).tolist(), "ends": np.round(ends, 5).tolist()}

    data = {
        "low": low.tolist(),
        "high": high.tolist(),
        "step": step,
        "view": [_TURN_RAD, _TILT_RAD],
        "groups": [
            {"name": name, "colour": colours[name].name, "poses": [pose_values(pose) for pose in group]}
            for name, group in shown.items()
        ],
    }
    entry = Markup('<li><i class="fill" style="background: {}"></i>{}</li>')
    key = Markup("").join(entry.format(colours[name].css, name) for name in shown)
    place = Markup(
        '<div class="poses"><ul class="key">{}</ul>{}<script type="application/json">{}</script></div>'
    )
    return Picture("Poses in 3D", caption, place.format(key, drawn, htmlsafe_json_dumps(data)))


def _flat(points: Array) -> Array:
    """Project (N, 3) points to the first view, (N, 2), seen from the side and from above."""
    turn, tilt = (np.array([np.sin(angle), np.cos(angle)]) for angle in (_TURN_RAD, _TILT_RAD))
    deep = points[:, 0] * turn[0] + points[:, 1] * turn[1]
    across = points[:, 0] * turn[1] - points[:, 1] * turn[0]
    return np.column_stack([across, points[:, 2] * tilt[1] + deep * tilt[0]])


def _ends(pose: Pose, length: float) -> Array:
    """Return the ends of a pose's x, y and z axes, (3, 3) m."""
    return pose.position_m + length * _LENGTHS[:, None] * pose.rotation.as_matrix().T


def _floor_lines(low: Array, high: Array, step: float) -> list[Array]:
    """Return lines of a grid below all poses, (2, 3) m each. low, high: (3,) corners of their box."""
    lines = []
    for axis, other in ((0, 1), (1, 0)):
        for value in np.arange(low[axis], high[axis] + step / 2, step):
            ends = np.array([low, low])
            ends[:, axis], ends[1, other] = value, high[other]
            lines.append(ends)
    return lines


def thumbnail(picture: Image, marks: Sequence[Array] = ()) -> bytes:
    """Draw a small picture, (H, W) or (H, W, 3) RGB, with points marked, as PNG."""
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB) if picture.ndim == 2 else picture.copy()
    for points in marks:
        for x, y in np.asarray(points, int):
            cv2.circle(colour, (int(x), int(y)), 4, (255, 120, 0), 2)
    scale = 320.0 / colour.shape[1]
    small = cv2.resize(np.asarray(colour, np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return encode_png(np.asarray(small, np.uint8))


def thumbnails(
    rejected: Sequence[Rejected],
    files: Mapping[str, Path],
    views: Mapping[str, View | str] | None = None,
    grey: bool = True,
) -> dict[str, bytes]:
    """Return PNG bytes of rejected samples by id, the points of their views marked; none without a file.

    files: pictures by id. Raises `InputError`.
    """
    found = {r.id: (views or {}).get(r.id) for r in rejected if r.id in files}
    return {
        name: thumbnail(read_image(files[name], grey=grey), [view.image_px] if isinstance(view, View) else [])
        for name, view in found.items()
    }


def sheet_pdf(spec: str) -> bytes:
    """Return the sheet of a target as PDF. Raises `InputError` for a target that is not understood."""
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
