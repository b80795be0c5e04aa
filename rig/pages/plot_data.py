"""Data of a figure, from which the page draws it again with zoom and values at the pointer.

`rig/pages/explore.js` draws it. Coordinates are those of the axes of the figure; dates are Unix times in s.
Colours are names of the palette.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_hex
from matplotlib.dates import AutoDateLocator
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.spines import Spine
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator
from numpy.typing import NDArray

from rig.pages.palette import NAME_BY_LIGHT_HEX

SECONDS_PER_DAY = 86_400
"""Matplotlib has dates in days since 1970, JavaScript in seconds."""
_DIGITS = 10
"""Significant digits of a coordinate: enough for a Unix time in s."""
_NO_LINE = ("None", " ", "")

Shape = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Spot:
    """A point of a figure with the text that is shown if the pointer is near it.

    anchor: id in the page of the lift that a click opens, "" for none.
    """

    x: float
    y: float
    text: str
    anchor: str = ""


def plot_data(figure: Figure, spots: Sequence[Spot]) -> dict[str, Any]:
    """Return a figure of lines, markers, boxes and texts on one pair of axes, ready for JSON."""
    (axes,) = figure.axes
    width, height = figure.get_size_inches()
    units = [SECONDS_PER_DAY if _is_date(axis) else 1 for axis in (axes.xaxis, axes.yaxis)]
    artists = [*axes.lines, *axes.patches, *axes.texts]
    shapes = [shape for artist in sorted(artists, key=Artist.get_zorder) for shape in _shapes(artist, axes)]
    return {
        "aspect": round(float(width / height), 3),
        "x": _axis(axes.xaxis, units[0]),
        "y": _axis(axes.yaxis, units[1]),
        "shapes": [{**shape, "at": _rounded(shape["at"] * units)} for shape in shapes],
        "key": _key(axes),
        "spots": [
            (*at, spot.text, spot.anchor)
            for at, spot in zip(
                _rounded(np.array([(s.x, s.y) for s in spots], float) * units), spots, strict=True
            )
        ],
    }


def _is_date(axis: Axis) -> bool:
    return isinstance(axis.get_major_locator(), AutoDateLocator)


def _rounded(values: NDArray[np.float64]) -> list[list[float]]:
    return [[float(f"{value:.{_DIGITS}g}") for value in row] for row in values]


def _axis(axis: Axis, unit: int) -> dict[str, Any]:
    """Describe an axis for JSON. limits: smallest and largest value. down: whether the axis is inverted."""
    ticks = None
    if isinstance(axis.get_major_locator(), FixedLocator):
        labels = [label.get_text() for label in axis.get_ticklabels()]
        ticks = list(zip(map(float, axis.get_ticklocs()), labels, strict=True))
    limits = sorted(unit * float(limit) for limit in axis.get_view_interval())
    label = axis.get_label_text().replace("\n", " ")
    return {
        "label": label,
        "limits": limits,
        "ticks": ticks,
        "date": unit > 1,
        "down": bool(axis.get_inverted()),
    }


def _key(axes: Axes) -> list[dict[str, Any]]:
    """Return the entries of the legend, if it is shown."""
    if axes.get_legend() is None:
        return []
    handles, labels = axes.get_legend_handles_labels()
    lines = [(line, text) for line, text in zip(handles, labels, strict=True) if isinstance(line, Line2D)]
    return [{"label": text, **_line(line)} for line, text in lines]


def _shapes(artist: Artist, axes: Axes) -> Iterator[Shape]:
    """Return an artist as lines, areas and texts, with points (N, 2) in the coordinates of the axes."""
    to_data = artist.get_transform() - axes.transData
    if isinstance(artist, Line2D):
        yield {"at": to_data.transform(artist.get_xydata()), **_line(artist)}
    elif isinstance(artist, Patch) and not isinstance(artist, Spine):
        for points in to_data.transform_path(artist.get_path()).to_polygons():
            yield {"at": points, "fill": _name(artist.get_facecolor()), "alpha": artist.get_alpha() or 1.0}
    elif isinstance(artist, Text) and artist.get_text():
        at = to_data.transform([artist.get_unitless_position()])
        align = artist.get_horizontalalignment()
        yield {"at": at, "text": artist.get_text(), "fill": _name(artist.get_color()), "align": align}


def _line(line: Line2D) -> Shape:
    """Describe the style of a line for JSON. dot: marker diameter in px; width 0: markers only."""
    marker = line.get_marker()
    return {
        "stroke": _name(line.get_color()),
        "width": 0.0 if line.get_linestyle() in _NO_LINE else line.get_linewidth(),
        "dash": line.get_linestyle() == "--",
        "dot": 0.0 if marker in _NO_LINE else line.get_markersize(),
        "marker": marker,
        "alpha": line.get_alpha() or 1.0,
    }


def _name(colour: Any) -> str:
    """Return a colour's name in the palette, or its hex value if it has none."""
    value = to_hex(colour)
    return NAME_BY_LIGHT_HEX.get(value, value)
