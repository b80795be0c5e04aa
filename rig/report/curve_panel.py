"""The growing curve of a film: drawn once as a whole, then revealed from the left over time."""

from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from drivers.types import Image
from rig.pages.figure import PX_PER_INCH, drawing
from rig.pages.palette import INK, PAPER
from rig.report.lift_chart import draw_lift
from rig.report.strips import rgb
from rig.sessions.lift_curves import LiftCurves

_SCALE = 1.25
"""Scale relative to a chart on a page, because films are watched from a larger distance."""


@dataclass(frozen=True, slots=True, eq=False)
class CurvePanel:
    """Images, (H, W, 3) uint8 RGB, of a lift's curves with their axes, and of the axes without curves.

    The time t, in s, is at column `origin_px + t * px_per_s`.
    """

    whole: Image
    axes: Image
    origin_px: float
    px_per_s: float

    def until(self, time_s: float) -> Image:
        """Return the curves up to a time, with a line at that time."""
        column = int(np.clip(round(self.origin_px + time_s * self.px_per_s), 0, self.whole.shape[1] - 1))
        picture = self.axes.copy()
        picture[:, :column] = self.whole[:, :column]
        picture[_TOP:-_BOTTOM, column] = rgb(INK.light)
        return picture


_TOP, _BOTTOM = 22, 46
"""Distances of the ends of the time line from the panel's edges, px: at the axes."""


def draw_panel(lift: LiftCurves, width_px: int, height_px: int) -> CurvePanel:
    """Draw a lift's curves at a size in px."""
    whole, origin, per_s = _drawn(lift, width_px, height_px, np.inf)
    axes, _, _ = _drawn(lift, width_px, height_px, -np.inf)
    return CurvePanel(whole, axes, origin, per_s)


def _drawn(lift: LiftCurves, width_px: int, height_px: int, until_s: float) -> tuple[Image, float, float]:
    with drawing(height_px / _SCALE, width_px / _SCALE, arranged=False) as figure:
        figure.set_dpi(PX_PER_INCH * _SCALE)
        figure.set_facecolor(PAPER.light)
        axes = draw_lift(figure, lift, until_s)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        zero, one = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0]
        return picture, float(zero), float(one - zero)
