"""Positions and orientations of the contacts of a recording."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from rig.pages.figure import drawing, legend_above
from rig.pages.palette import FIRST, INK, SECOND
from rig.report.parts import Chart
from rig.report.recording import Taken

BIN_DEG = 15.0
CELLS = (3, 4)
"""Number of cells across and down the sensor; each cell should have been touched."""
_TICK_PX = 16.0
_SENSOR_COLOURS = (FIRST, SECOND)


def place_map(serial: str, taken: Sequence[Taken]) -> Chart:
    """Draw the fraction of the images in which each pixel of a sensor was touched, and the contacts' axes."""
    height, width = taken[0].image.shape[:2]
    touched = share_touched(taken)
    with drawing(370, 330) as figure:
        axes = figure.subplots()
        shown = axes.imshow(
            touched * 100.0,
            extent=(0, width, height, 0),
            cmap="cividis",
            vmin=0,
            vmax=100,
            interpolation="nearest",
        )
        figure.colorbar(shown, ax=axes, label="touched in, % of the images", shrink=0.8)
        for image in taken:
            _mark(axes, image)
        axes.set(xlabel="x, px", ylabel="y, px", xlim=(0, width), ylim=(height, 0))
        axes.grid(False)
        title = f"Positions of the contacts on {serial}"
        caption = "Dots: centres of the contacts; strokes: their long axes; round ones have none."
        return Chart(title, figure, caption)


def axis_histogram(by_serial: dict[str, list[Taken]]) -> Chart:
    """Draw a histogram of the orientations of the contacts' long axes, per sensor."""
    edges = np.arange(-90.0, 90.0 + BIN_DEG, BIN_DEG)
    with drawing(260) as figure:
        axes = figure.subplots()
        for i, (serial, taken) in enumerate(by_serial.items()):
            counts, _ = np.histogram(axes_deg(taken), edges)
            share = BIN_DEG / (len(by_serial) + 0.5)
            axes.bar(
                edges[:-1] + share * (i + 0.75), counts, share, label=serial,
                color=_SENSOR_COLOURS[i % 2].light, hatch=("", "///")[i % 2], edgecolor=INK.light,
                linewidth=0.6,
            )  # fmt: skip
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.set(xlabel="long axis in the image, degrees", ylabel="images")
        axes.grid(False, axis="x")
        legend_above(axes, 2)
        title = "Orientations of the contacts"
        caption = (
            "Counter-clockwise from the image's x; -90 and 90 are the same axis. Without round contacts."
        )
        return Chart(title, figure, caption)


def share_touched(taken: Sequence[Taken]) -> NDArray[np.float64]:
    """Return the fraction of the images in which each pixel was touched, (H, W), 0 to 1."""
    masks = [t.contact.mask > 0 for t in taken if t.contact.mask is not None]
    if not masks:
        return np.zeros(taken[0].image.shape[:2])
    return np.mean(masks, axis=0)


def axes_deg(taken: Sequence[Taken]) -> NDArray[np.float64]:
    """Return the known long axes, (N,) deg in (-90, 90]."""
    return np.array([t.axis_deg for t in taken if t.axis_deg is not None], float)


def untouched_cells(taken: Sequence[Taken]) -> list[str]:
    """Return the cells of the sensor that no contact reached, in words."""
    touched = share_touched(taken)
    names = []
    for y, rows in enumerate(np.array_split(touched, CELLS[1], axis=0)):
        for x, cell in enumerate(np.array_split(rows, CELLS[0], axis=1)):
            if cell.max() == 0.0:
                names.append(f"{_ROWS[y]} {_COLUMNS[x]}")
    return names


_ROWS = ("top", "upper", "lower", "bottom")
_COLUMNS = ("left", "middle", "right")


def empty_orientations(taken: Sequence[Taken]) -> list[tuple[float, float]]:
    """Return ranges of orientation, deg from and to, without any contact's axis."""
    edges = np.arange(-90.0, 90.0 + BIN_DEG, BIN_DEG)
    counts, _ = np.histogram(axes_deg(taken), edges)
    gaps: list[tuple[float, float]] = []
    for count, low in zip(counts, edges, strict=False):
        if count == 0 and gaps and gaps[-1][1] == low:
            gaps[-1] = (gaps[-1][0], float(low + BIN_DEG))
        elif count == 0:
            gaps.append((float(low), float(low + BIN_DEG)))
    return gaps


def _mark(axes: Axes, image: Taken) -> None:
    center = image.center_px
    if center is None:
        return
    halo = [Stroke(linewidth=2.6, foreground="#fefefe"), Normal()]
    axes.plot(*center, ".", color="black", markersize=3.0, path_effects=halo)
    if image.axis_deg is not None:
        turn = math.radians(image.axis_deg)
        x, y = _TICK_PX * math.cos(turn), -_TICK_PX * math.sin(turn)
        across, down = [center[0] - x, center[0] + x], [center[1] - y, center[1] + y]
        axes.plot(across, down, color="black", linewidth=0.8, path_effects=halo)
