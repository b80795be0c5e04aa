"""The growing curve of a film: drawn whole once, then uncovered from the left as time goes on."""

from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from drivers.types import Image
from rig.pages.figure import PX_PER_INCH, drawing
from rig.pages.palette import INK, PAPER
from rig.report.curves import LiftCurves
from rig.report.lift_chart import draw_lift
from rig.report.strips import rgb

_SCALE = 1.25
"""Drawn larger than on a page, as a film is looked at from further away."""


@dataclass(frozen=True, slots=True, eq=False)
class CurvePanel:
    """A lift's curves as pictures, (H, W, 3) uint8 RGB: all of them, and the axes alone.

    A time t, s, lies at column `origin_px + t * px_per_s`.
    """

    whole: Image
    axes: Image
    origin_px: float
    px_per_s: float

    def until(self, time_s: float) -> Image:
        """The curves as far as they are known at a time, with a line where it stands."""
        column = int(np.clip(round(self.origin_px + time_s * self.px_per_s), 0, self.whole.shape[1] - 1))
        picture = self.axes.copy()
        picture[:, :column] = self.whole[:, :column]
        picture[_TOP:-_BOTTOM, column] = rgb(INK.light)
        return picture


_TOP, _BOTTOM = 22, 46
"""Where the line that marks the time ends, px from the panel's edges: at the axes."""


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
