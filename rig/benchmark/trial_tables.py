"""The tables and the picture of `rig benchmark trials`, with the paper's figures beside ours."""

import io

from matplotlib.figure import Figure

from rig.benchmark.scores import Score
from rig.benchmark.tables import Table
from rig.benchmark.trial_passes import TABLE_WINDOWS, combination
from rig.benchmark.trials import NETWORKS, OURS, TrialsResult
from rig.metrics import Mare
from rig.tactile.axis import METHODS
from rig.tactile.estimator import DEFAULT_ESTIMATOR, KOLAMURI, PAPER_WINDOW

PAPER_THREE = {
    ("DeepLabV3+", "pca"): (3.52, 3.81, 4.13, 4.42, 4.76),
    ("DeepLabV3+", "ellipse"): (2.82, 3.06, 3.36, 3.65, 3.97),
    ("DeepLabV3+", "skeleton"): (1.85, 2.02, 2.18, 2.37, 2.62),
    ("UNet++", "pca"): (3.48, 3.78, 4.05, 4.33, 4.66),
    ("UNet++", "ellipse"): (2.93, 3.17, 3.43, 3.72, 4.03),
    ("UNet++", "skeleton"): (1.90, 2.01, 2.20, 2.44, 2.67),
    ("PSPNet", "pca"): (3.56, 3.86, 4.18, 4.50, 4.81),
    ("PSPNet", "ellipse"): (2.90, 3.14, 3.42, 3.72, 4.02),
    ("PSPNet", "skeleton"): (1.85, 2.02, 2.19, 2.41, 2.63),
}
"""Castano-Amoros and Gil 2023, Table III: MARE in degrees by window, on its real bench."""
PAPER_FOUR = {KOLAMURI: "4.39 +- 0.18 (other objects)", "PSPNet and skeleton": "1.85 +- 0.96"}
"""The same, Table IV."""
NOT_HERE = {
    "Toskov et al.": ("not built", "3.96 (other objects)"),
    "AngleNet": ("not built", "3.23 +- 1.69 (trained on its test lifts)"),
}
NONE = "-"


def train_command(network: str) -> str:
    """Return the commands that train a network of the paper and bring it into this benchmark."""
    return (
        f"rig train --arch {network} --fold D_s3 --units family --out RUN, "
        f"then --model {network}=RUN/{network}_D_s3/model.onnx"
    )


def table_three(result: TrialsResult) -> Table:
    """MARE over phase B by network, angle method and window; the paper's in brackets."""
    titles = {title: name for name, title in NETWORKS.items()}
    rows = []
    for title in (*titles, OURS):
        if titles.get(title) in result.missing:
            rows.append((title, f"not trained yet: {train_command(titles[title])}", *[NONE] * 6))
            continue
        rows += [_three(result, title, method) for method in METHODS]
    best = result.scores[DEFAULT_ESTIMATOR, 1]
    rows.append(
        (DEFAULT_ESTIMATOR, "no window", _mare(best.mare), *[NONE] * 4, _ms(result, DEFAULT_ESTIMATOR))
    )
    columns = ("network", "method", *(f"window {n}" for n in TABLE_WINDOWS), "ms per frame")
    return Table(f"{_head(result)}: the paper's Table III (its figures in brackets)", columns, rows)


def table_four(result: TrialsResult) -> Table:
    """Every system with its usual window, and what the paper says of it."""
    rows = []
    for name in _systems(result):
        score = result.scores[name, usual_window(name)]
        rows.append((name, *_cells(score), _ms(result, name), PAPER_FOUR.get(name, NONE)))
    rows += [(name, why, NONE, NONE, NONE, paper) for name, (why, paper) in NOT_HERE.items()]
    columns = ("system", "MARE", "95 % interval", "answered", "ms per frame", "paper")
    return Table(f"{_head(result)}: the paper's Table IV", columns, rows)


def notes(result: TrialsResult) -> list[str]:
    """Say what the figures are and are not."""
    return [
        "SIMULATED: the paper's figures are of its real bench and objects; they rank nothing here.",
        f"One fingertip at 30 frames per second, {result.frames} frames of phase B; times in one process "
        "and one thread, medians.",
        "The angle methods are the mended ones: a contact too round for an axis is refused, not guessed.",
        "kolamuri runs on the same lifts with dots printed on the gel. A gel follows a turn by 10 degrees "
        "at most, and what turns further slides over it.",
    ]


def usual_window(system: str) -> int:
    """The window a system is used with: the paper's two, or none."""
    return 1 if system in (DEFAULT_ESTIMATOR, KOLAMURI) else PAPER_WINDOW


def draw(result: TrialsResult) -> bytes:
    """Return the picture as PNG: run time against error, a point per system."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots()
    for name in _systems(result):
        mare = result.scores[name, usual_window(name)].mare
        if mare is None:
            continue
        ours = name == DEFAULT_ESTIMATOR
        axes.plot(
            result.ms[name], mare.mean_deg, "o" if ours else "s", color="#0072B2" if ours else "#B07800"
        )
        axes.annotate(
            name, (result.ms[name], mare.mean_deg), xytext=(6, 0), textcoords="offset points", va="center"
        )
    axes.set(
        xscale="log", yscale="log", xlabel="frame in to angle out, median, ms (one thread)",
        ylabel="MARE over phase B, degrees", title=_head(result),
    )  # fmt: skip
    axes.margins(x=0.25)
    axes.grid(True, color="0.9")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130, metadata={"Software": None})
    return stream.getvalue()


def _systems(result: TrialsResult) -> list[str]:
    return list(dict.fromkeys(name for name, _ in result.scores))


def _head(result: TrialsResult) -> str:
    return f"SIMULATED, {result.lifts} lifts, one fingertip, phase B"


def _three(result: TrialsResult, title: str, method: str) -> tuple[str, ...]:
    paper = PAPER_THREE.get((title, method), ("",) * len(TABLE_WINDOWS))
    name = combination(title, method)
    cells = [
        _mare(result.scores[name, window].mare) + (f" ({figure})" if figure else "")
        for window, figure in zip(TABLE_WINDOWS, paper, strict=True)
    ]
    return (title, method, *cells, _ms(result, name))


def _cells(score: Score) -> tuple[str, str, str]:
    mare = score.mare
    sure = mare is not None and mare.low_deg is not None
    interval = f"{mare.low_deg:.2f} to {mare.high_deg:.2f}" if mare is not None and sure else NONE
    return _mare(mare), interval, f"{score.answered:.1%}"


def _mare(mare: Mare | None) -> str:
    return NONE if mare is None else f"{mare.mean_deg:.2f} +- {mare.std_deg:.2f}"


def _ms(result: TrialsResult, name: str) -> str:
    return f"{result.ms[name]:.2f}"
