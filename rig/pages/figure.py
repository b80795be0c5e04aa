"""Figures for pages: drawn once with matplotlib, then coloured by the page for light and dark mode.

The text of a figure remains text in the SVG, so that it can be searched, read aloud and scaled. A figure is
drawn at its width on a desktop; on a phone it is scaled down, and its labels are still legible.
"""

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from numpy.typing import NDArray

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
def _styled() -> Iterator[None]:
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
    with _styled():
        size = (width_px / PX_PER_INCH, height_px / PX_PER_INCH)
        yield Figure(figsize=size, layout="constrained" if arranged else None)


def placed(figure: Figure, left_px: float, top_px: float, right_px: float, bottom_px: float) -> Axes:
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


def band(axes: Axes, x: Floats, middle: Floats, half: Floats, colour: str) -> None:
    """Fill `middle` +- `half`, clipped at the limits of the axes, which must be set before the call."""
    low, high = (np.clip(edge, *axes.get_ylim()) for edge in (middle - half, middle + half))
    axes.fill_between(x, low, high, color=colour, alpha=0.22, linewidth=0)


def svg(figure: Figure, alt: str) -> Markup:
    """Return a figure as inline SVG with the colours of the page. alt: description for screen readers."""
    buffer = io.StringIO()
    with _styled():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace("\n", " ")
    for pattern, instead in _SUPERFLUOUS:
        text = pattern.sub(instead, text)
    # coordinates in tags are rounded to hundredths of a pixel; numbers in labels must not be rounded
    text = _TAG.sub(lambda tag: _DIGITS.sub(r".\1", tag.group()), text)
    text = _own_ids(text, f"f{next(_number)}-")
    text = re.sub(r"#[0-9a-f]{6}\b", _in_css, text)
    head = f'<svg role="img" aria-label="{Markup.escape(alt)}" '
    return Markup(text.replace("<svg ", head, 1))  # noqa: S704 - drawn here; the alt text is escaped


def png(figure: Figure, dpi: float) -> bytes:
    """Return a figure as PNG on white paper."""
    buffer = io.BytesIO()
    with _styled():
        figure.savefig(buffer, format="png", dpi=dpi, facecolor=PAPER.light, metadata={"Software": None})
    return buffer.getvalue()


def column_files(figure: Figure) -> dict[str, bytes]:
    """Return a figure with the width of a paper's column as PDF, SVG and PNG, by file suffix.

    The whole figure is scaled, including labels and lines, and keeps that size afterwards.
    """
    _scale(figure, COLUMN_IN / float(figure.get_size_inches()[0]))
    found = {}
    with _styled(), mpl.rc_context({"svg.fonttype": "path", "pdf.fonttype": 42}):
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


_SUPERFLUOUS = (
    (re.compile(r"<metadata>.*?</metadata>|<style.*?</style>", re.DOTALL), ""),
    (re.compile(r'\bid="(?:figure|axes|patch|line2d|text|matplotlib\.axis|xtick|ytick|legend)_\d+"'), ""),
    (re.compile(r"font-family: [^;\"]*;"), ""),
    (re.compile(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"'), r"\1"),
    (re.compile(r"[ \n]+(?=[ >])"), ""),
)
"""Parts of an SVG that are removed: they are equal in all figures, or the page defines them."""
_TAG, _DIGITS = re.compile(r"<[^>]+>"), re.compile(r"\.(\d\d)\d+")


def _in_css(colour: re.Match[str]) -> str:
    """Return a hex colour of the palette as a CSS variable; other colours unchanged."""
    name = NAME_BY_LIGHT_HEX.get(colour.group())
    return f"var(--{name})" if name else colour.group()


def _own_ids(text: str, prefix: str) -> str:
    """Make the ids of a figure unique, because a page contains several figures."""
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    return re.sub(r"(url\(|href=\")#", rf"\1#{prefix}", text)
