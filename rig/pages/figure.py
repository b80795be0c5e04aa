"""Figures for pages: drawn once with matplotlib, then coloured by the page for light and dark mode.

The text of a figure remains text in the SVG, so that it can be searched, read aloud and scaled. A figure is
drawn at its width on a desktop; on a phone it is scaled down, and its labels are still legible. The page can
also draw a figure again from its data (`rig/pages/explore.js`), with zoom and values at the pointer.
"""

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.dates import AutoDateLocator
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.spines import Spine
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator
from numpy.typing import NDArray

from rig.pages.numbers import with_minus
from rig.pages.palette import INK, LINE, MUTED, NAME_BY_LIGHT_HEX, PAPER

Floats = NDArray[np.float64]
PX_PER_INCH = 72
"""Matplotlib's SVG has 72 units per inch; one unit is displayed as one CSS pixel."""
WIDTH_PX = 400
"""Width of a figure: three fit side by side on a desktop; on a phone one fits, scaled down slightly."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    # names of files and objects may contain a $, which must not start a formula
    "text.parse_math": False,
    "svg.hashsalt": "rig",
    "font.family": "sans-serif",
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "xtick.labelsize": 10.5,
    "ytick.labelsize": 10.5,
    "legend.fontsize": 10.5,
    "text.color": INK.light,
    "axes.labelcolor": INK.light,
    "axes.edgecolor": MUTED.light,
    "xtick.color": MUTED.light,
    "ytick.color": MUTED.light,
    "xtick.labelcolor": INK.light,
    "ytick.labelcolor": INK.light,
    "grid.color": LINE.light,
    "grid.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "path.simplify_threshold": 0.3,
}
_number = count()
COLUMN_IN = 88.9 / 25.4
"""Width of a column of a paper in IEEE's format, 88.9 mm."""
_NO_DATE: dict[str, None] = {"CreationDate": None, "Creator": None, "Producer": None}
_PAPER: dict[str, dict[str, Any]] = {
    "pdf": {"metadata": _NO_DATE},
    "svg": {"metadata": {"Date": None, "Creator": None}},
    "png": {"dpi": 600, "facecolor": PAPER.light, "metadata": {"Software": None}},
}
"""Settings for saving a figure for a paper, by format; the bytes are reproducible."""
_TICKS = ("xtick.labelsize", "xtick.major.pad", "xtick.major.size")
_PAD_IN = 0.04167
"""Matplotlib's own margin around arranged axes."""


@contextmanager
def _page_style() -> Iterator[None]:
    """Draw in the pages' style.

    Characters that are missing in matplotlib's font cause no warning, because the browser draws the text of
    an SVG with its own fonts.
    """
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font")
        yield


@contextmanager
def drawing(height_px: float, width_px: float = WIDTH_PX, arranged: bool = True) -> Iterator[Figure]:
    """Yield an empty figure of this size in CSS pixels, in the style of the pages.

    arranged: use matplotlib's constrained layout, which takes as long as drawing; else the caller places the
    axes.
    """
    with _page_style():
        size = (width_px / PX_PER_INCH, height_px / PX_PER_INCH)
        yield Figure(figsize=size, layout="constrained" if arranged else None)


def add_axes(figure: Figure, left_px: float, top_px: float, right_px: float, bottom_px: float) -> Axes:
    """Add axes with margins in CSS pixels from the figure's edges."""
    width, height = figure.get_size_inches() * PX_PER_INCH
    spans = (width - left_px - right_px) / width, (height - top_px - bottom_px) / height
    return figure.add_axes((left_px / width, bottom_px / height, *spans))


def limits(*values: Floats, room: float, least: float) -> tuple[float, float]:
    """Return axis limits that contain 0 and all finite values.

    room: margin on either side, as a share of the range; least: smallest margin, in the values' unit.
    """
    known = np.concatenate([np.zeros(1), *(np.ravel(part) for part in values)])
    known = known[np.isfinite(known)]
    low, high = float(known.min()), float(known.max())
    margin = max(room * (high - low), least)
    return low - margin, high + margin


def band(axes: Axes, x: Floats, middle: Floats, half: Floats, colour: str, label: str = "") -> None:
    """Fill `middle` +- `half`, clipped at the limits of the axes, which must be set before the call."""
    low, high = (np.clip(edge, *axes.get_ylim()) for edge in (middle - half, middle + half))
    axes.fill_between(x, low, high, color=colour, alpha=0.22, linewidth=0, label=label)


def svg(figure: Figure, alt: str) -> Markup:
    """Return a figure as inline SVG with the colours of the page. alt: description for screen readers."""
    return with_own_ids(drawn_svg(figure, alt))


def drawn_svg(figure: Figure, alt: str) -> str:
    """Draw a figure as `svg` does, in any process; `with_own_ids` puts it on a page."""
    buffer = io.StringIO()
    with _page_style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace("\n", " ")
    for pattern, instead in _SUPERFLUOUS:
        text = pattern.sub(instead, text)
    # coordinates in tags are rounded to hundredths of a pixel; numbers in labels must not be rounded
    text = _TAG.sub(lambda tag: _DIGITS.sub(r".\1", tag.group()), text)
    css = {colour: f"var(--{name})" for colour, name in NAME_BY_LIGHT_HEX.items()}
    text = re.sub(r"#[0-9a-f]{6}\b", lambda colour: css.get(colour.group(), colour.group()), text)
    head = f'<svg role="img" aria-label="{Markup.escape(alt)}" '
    return text.replace("<svg ", head, 1)


def with_own_ids(drawn: str) -> Markup:
    """Return the result of `drawn_svg` with ids that no other figure of a page has."""
    prefix = f"f{next(_number)}-"
    text = re.sub(r'\bid="', f'id="{prefix}', drawn)
    return Markup(re.sub(r"(url\(|href=\")#", rf"\1#{prefix}", text))  # noqa: S704 - drawn here, with the alt text escaped


def column_files(figure: Figure) -> dict[str, bytes]:
    """Return a figure with the width of a paper's column as PDF, SVG and PNG, by file suffix.

    The whole figure is scaled, including labels and lines, and keeps that size afterwards.
    """
    _scale(figure, COLUMN_IN / float(figure.get_size_inches()[0]))
    found = {}
    with _page_style(), mpl.rc_context({"svg.fonttype": "path", "pdf.fonttype": 42}):
        for kind, values in _PAPER.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, **values)
            found[kind] = buffer.getvalue()
    return found


def _scale(figure: Figure, factor: float) -> None:
    figure.set_size_inches(*(figure.get_size_inches() * factor))
    layout = figure.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        layout.set(w_pad=_PAD_IN * factor, h_pad=_PAD_IN * factor)
    for artist in figure.findobj():
        if isinstance(artist, Text):
            artist.set_fontsize(float(artist.get_fontsize()) * factor)
        elif isinstance(artist, Line2D):
            artist.set_markersize(artist.get_markersize() * factor)
            artist.set_linewidth(artist.get_linewidth() * factor)
        elif isinstance(artist, Patch):
            artist.set_linewidth(artist.get_linewidth() * factor)
        elif isinstance(artist, Collection):
            artist.set_linewidth([float(width) * factor for width in np.ravel(artist.get_linewidth())])
    for axes in figure.axes:  # tick labels, including those that are created later
        size, pad, length = (factor * float(_STYLE.get(key, mpl.rcParams[key])) for key in _TICKS)
        axes.tick_params(which="both", labelsize=size, pad=pad, length=length)


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Put the legend above the axes, so that it covers no curve."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2, handlelength=1.4,
        columnspacing=1.1, handletextpad=0.5,
    )  # fmt: skip


def legend_outside(figure: Figure) -> None:
    """Add room above a figure with a legend of its labelled artists, unless its axes have a legend."""
    entries = {
        label: handle
        for axes in figure.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    if not entries or any(axes.get_legend() for axes in figure.axes):
        return
    width, height = (float(size) for size in figure.get_size_inches())
    room = _LEGEND_ROW_IN * -(-len(entries) // _LEGEND_COLUMNS)
    boxes = [axes.get_position() for axes in figure.axes]
    figure.set_size_inches(width, height + room)
    arranged = figure.get_layout_engine() is not None
    if not arranged:
        share = height / (height + room)
        for axes, box in zip(figure.axes, boxes, strict=True):
            axes.set_position((box.x0, box.y0 * share, box.width, box.height * share))
    place = "outside upper center" if arranged else "upper center"
    with _page_style():
        figure.legend(
            list(entries.values()), list(entries), loc=place, ncols=_LEGEND_COLUMNS, borderaxespad=0.1,
            handlelength=1.4, columnspacing=1.1, handletextpad=0.5, labelspacing=0.3,
        )  # fmt: skip


_LEGEND_COLUMNS, _LEGEND_ROW_IN = 3, 0.25
_SUPERFLUOUS = (
    (re.compile(r"<metadata>.*?</metadata>|<style.*?</style>", re.DOTALL), ""),
    (re.compile(r'\bid="(?:figure|axes|patch|line2d|text|matplotlib\.axis|xtick|ytick|legend)_\d+"'), ""),
    (re.compile(r"font-family: [^;\"]*;"), ""),
    (re.compile(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"'), r"\1"),
    (re.compile(r"[ \n]+(?=[ >])"), ""),
)
"""Parts of an SVG that are removed: they are equal in all figures, or the page defines them."""
_TAG, _DIGITS = re.compile(r"<[^>]+>"), re.compile(r"\.(\d\d)\d+")


SECONDS_PER_DAY = 86_400
"""Matplotlib has dates in days since 1970, JavaScript in seconds."""
_SIGNIFICANT = 10
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
    locators = [axis.get_major_locator() for axis in (axes.xaxis, axes.yaxis)]
    units = [SECONDS_PER_DAY if isinstance(each, AutoDateLocator) else 1 for each in locators]
    places = _round(np.array([(spot.x, spot.y) for spot in spots], float) * units)
    artists = [*axes.lines, *axes.patches, *axes.texts]
    shapes = [shape for artist in sorted(artists, key=Artist.get_zorder) for shape in _shapes(artist, axes)]
    key = [] if axes.get_legend() is None else zip(*axes.get_legend_handles_labels(), strict=True)
    return {
        "aspect": round(float(width / height), 3),
        "x": _axis(axes.xaxis, units[0]),
        "y": _axis(axes.yaxis, units[1]),
        "shapes": [{**shape, "at": _round(shape["at"] * units)} for shape in shapes],
        "key": [{"label": text, **_line(line)} for line, text in key if isinstance(line, Line2D)],
        "spots": [(*at, with_minus(spot.text), spot.anchor) for at, spot in zip(places, spots, strict=True)],
    }


def _round(values: NDArray[np.float64]) -> list[list[float]]:
    return [[float(f"{value:.{_SIGNIFICANT}g}") for value in row] for row in values]


def _axis(axis: Axis, unit: int) -> dict[str, Any]:
    """Describe an axis for JSON. limits: smallest and largest value. down: whether the axis is inverted."""
    ticks = None
    if isinstance(axis.get_major_locator(), FixedLocator):
        labels = [label.get_text() for label in axis.get_ticklabels()]
        ticks = list(zip(map(float, axis.get_ticklocs()), labels, strict=True))
    limits = sorted(unit * float(limit) for limit in axis.get_view_interval())
    label, down = axis.get_label_text().replace("\n", " "), bool(axis.get_inverted())
    return {"label": label, "limits": limits, "ticks": ticks, "date": unit > 1, "down": down}


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
