"""`rig benchmark trials`: the paper's Tables III and IV on the same simulated lifts in one run."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from markupsafe import Markup
from matplotlib.axes import Axes

from rig.benchmark.estimators.picture import label_points
from rig.benchmark.estimators.study import record
from rig.benchmark.harness import Report, Run, Study, machine, option
from rig.benchmark.segmentation.paper_table import NETWORKS, OURS
from rig.benchmark.segmentation.study import parse_models
from rig.benchmark.trials.paper_tables import (
    TrialsResult,
    head,
    notes,
    summarize,
    systems,
    table_four,
    table_three,
    usual_window,
)
from rig.benchmark.trials.passes import (
    ANGLENET_ON_TEST,
    PEER_FILES,
    PLAIN,
    STILL,
    TrialPass,
    combination,
    pass_lift,
    title,
)
from rig.config import load_bench
from rig.config.models import BenchConfig
from rig.experiments.trial import resolve_objects
from rig.pages.figure import drawing, png, svg
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, FIRST, MUTED, WARNING
from rig.sessions.records import FinishedLift
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import DEFAULT_ESTIMATOR, KOLAMURI, choose_estimator
from rig.tactile.paper.axis import METHODS

PICTURE, PAGE = "trials.png", "index.html"
PLAIN_SESSION, MARKED_SESSION = "session", "session-markers"


@dataclass(frozen=True, slots=True)
class TrialsOptions:
    """Options of `rig benchmark trials`."""

    model: list[str] | None = option(
        None,
        "NAME=FILE: a network of rig train (pspnet, deeplabv3plus, unetplusplus, ours) or rig "
        "train-angle (anglenet, anglenet-on-test, toskov) beside the shipped ones; repeat for more.",
    )
    lifts: int = option(5, "Lifts of each object.", min=1, max=100)
    objects: list[str] | None = option(None, "Only this object; repeat for more.", "--object")


def measure(options: TrialsOptions, run: Run) -> Report:
    """Score networks, angle methods, windows and the paper's rivals on the same SIMULATED lifts.

    As in the paper, one fingertip is used, at 30 frames per second, over phase B. For networks that are not
    trained yet the tables show the command that trains them. An interrupted run continues with --out. The run
    takes at most 20 minutes on two cores, with all nine objects and five lifts of each.

    Examples:
      rig benchmark trials --out trials

      rig benchmark trials --lifts 1 --object t3 --out quick --json

      rig benchmark trials --model unetplusplus=runs/unetplusplus_D_s3/model.onnx

      rig benchmark trials --out trials --model anglenet-on-test=runs/anglenet-on-test/model.onnx

    """
    began = time.perf_counter()
    models = parse_models(options.model or [], (*NETWORKS, OURS, *PEER_FILES))
    known = {"pspnet": "pspnet", OURS: OURS, **{name: str(file) for name, file in models.items()}}
    titles = {**NETWORKS, OURS: OURS}
    networks = {title: known[name] for name, title in titles.items() if name in known}
    peers = {name: file for name, file in models.items() if name in PEER_FILES}
    systems = (*PLAIN, *((ANGLENET_ON_TEST,) if ANGLENET_ON_TEST in models else ()))
    bench = load_bench("fake")
    what = resolve_objects(options.objects), options.lifts
    plain = record(run, PLAIN_SESSION, bench, choose_estimator(DEFAULT_ESTIMATOR), *what)
    marked = record(run, MARKED_SESSION, with_markers(bench), choose_estimator(KOLAMURI), *what)

    def passes(folder: Path, networks: dict[str, str], systems: Sequence[str]) -> list[TrialPass]:
        work = partial(pass_lift, folder, networks, systems, peers)
        rows = read_finished_lifts(folder)
        return run.each(work, rows, _name, workers=1)  # one process, so that times can be compared

    missing = tuple(name for name, title in NETWORKS.items() if title not in networks)
    of_plain, of_marked = passes(plain, networks, systems), passes(marked, {}, (KOLAMURI,))
    result = summarize(of_plain, of_marked, missing, plain)
    tables = (table_three(result), table_four(result))
    picture, chart = draw(result)
    page = render(
        "rig.benchmark.trials",
        "trials.html",
        lifts=result.lifts,
        frames=result.frames,
        seed=run.seed,
        of=machine(),
        minutes=f"{(time.perf_counter() - began) / 60.0:.1f}",
        picture=chart,
        tables=tables,
        notes=notes(result),
    )
    scores = [
        {"system": name, "window": window, "ms": result.ms[name], **asdict(score)}
        for (name, window), score in result.scores.items()
    ]
    figures = {"lifts": result.lifts, "frames": result.frames, "systems": scores, "not_trained": missing}
    return Report(tables, notes=notes(result), figures=figures, files={PICTURE: picture, PAGE: page})


def with_markers(bench: BenchConfig) -> BenchConfig:
    """Return the bench with markers printed on its gels and no other difference."""
    tactile = tuple(t.model_copy(update={"markers": True}) for t in bench.tactile)
    return bench.model_copy(update={"tactile": tactile})


def _name(row: FinishedLift) -> str:
    return f"{row.object}/{row.lift}"


STUDY = Study(
    name="trials",
    options=TrialsOptions,
    measure=measure,
    cases="lifts",
    shared=("out", "jobs", "seed"),
    keeps_results=True,
)


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
