"""`rig benchmark trials`: the paper's Tables III and IV on the same simulated lifts in one run."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from rig.benchmark.estimators.study import record
from rig.benchmark.harness import Report, Run, Study
from rig.benchmark.segmentation.paper_table import NETWORKS, OURS
from rig.benchmark.segmentation.study import parse_models
from rig.benchmark.trials.paper_tables import (
    notes,
    summarize,
    table_four,
    table_three,
)
from rig.benchmark.trials.passes import (
    ANGLENET_ON_TEST,
    PEER_FILES,
    PLAIN,
    TrialPass,
    pass_lift,
)
from rig.config import load_bench
from rig.config.models import BenchConfig
from rig.declared import option
from rig.experiments.trial import resolve_objects
from rig.sessions.records import FinishedLift
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import DEFAULT_ESTIMATOR, KOLAMURI, choose_estimator

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
    scores = [
        {"system": name, "window": window, "ms": result.ms[name], **asdict(score)}
        for (name, window), score in result.scores.items()
    ]
    figures = {"lifts": result.lifts, "frames": result.frames, "systems": scores, "not_trained": missing}
    return Report(tables, notes=notes(result), figures=figures)


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
