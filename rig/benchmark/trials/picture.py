"""The picture of `rig benchmark trials`: run time against error, a point per system."""

from markupsafe import Markup
from matplotlib.axes import Axes

from rig.benchmark.estimators.picture import label_points
from rig.benchmark.segmentation.paper_table import NETWORKS, OURS
from rig.benchmark.trials.paper_tables import TrialsResult, head, systems, usual_window
from rig.benchmark.trials.passes import STILL, combination, title
from rig.pages.figure import drawing, png, svg
from rig.pages.palette import ESTIMATE, FIRST, MUTED, WARNING
from rig.tactile.estimators import DEFAULT_ESTIMATOR
from rig.tactile.paper.axis import METHODS

_LABEL_GAP = 0.034
_DPI = 130
WIDTH_PX, HEIGHT_PX = 760, 520
# of Okabe and Ito, distinct with any colour vision; the shapes differ, too
_OURS, _NETWORKS, _OTHERS = (ESTIMATE.light, "o"), (WARNING.light, "s"), (FIRST.light, "^")


def draw(result: TrialsResult) -> tuple[bytes, Markup]:
    """Return the picture as PNG, and as SVG in a page's colours."""
    with drawing(HEIGHT_PX, WIDTH_PX) as figure:
        _draw(figure.subplots(), result)
        return png(figure, _DPI), svg(figure, "Run time against error of every system")


def _draw(axes: Axes, result: TrialsResult) -> None:
    shown = [
        (name, result.ms[name], mare.mean_deg)
        for name in systems(result)
        if name != STILL and (mare := result.scores[name, usual_window(name)].mare)
    ]
    for name, ms, error in shown:
        colour, marker = _look(name)
        axes.plot([ms], [error], marker, color=colour, markersize=8)
    _still(axes, result)
    axes.set(
        xscale="log", yscale="log", xlabel="frame in to angle out, median, ms (one thread)",
        ylabel="MARE over phase B, degrees", title=head(result),
    )  # fmt: skip
    axes.margins(x=0.05, y=0.06)
    points = [(title(name), ms, error, _look(name)[0]) for name, ms, error in shown]
    label_points(axes, points, _LABEL_GAP, 1.03, {"linewidth": 0.7, "alpha": 0.6, "relpos": (0.0, 0.5)})


def _look(name: str) -> tuple[str, str]:
    if name == DEFAULT_ESTIMATOR:
        return _OURS
    by_network = {combination(network, m) for network in (*NETWORKS.values(), OURS) for m in METHODS}
    return _NETWORKS if name in by_network else _OTHERS


def _still(axes: Axes, result: TrialsResult) -> None:
    """Draw the error of always reporting 0."""
    still = result.scores[STILL, 1].mare
    if still is not None:
        axes.axhline(still.mean_deg, color=MUTED.light, linestyle=":", zorder=1)
        axes.text(
            0.01, still.mean_deg, title(STILL), transform=axes.get_yaxis_transform(), va="bottom",
            fontsize=10.5, color=MUTED.light,
        )  # fmt: skip
