"""The tables of `rig benchmark trials`, with the paper's figures beside ours."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import counted
from rig.benchmark.estimators.scores import ContenderScore, score_all
from rig.benchmark.harness import NONE, Table
from rig.benchmark.segmentation.paper_table import NETWORKS, OURS
from rig.benchmark.trials.passes import (
    ANGLENET_ON_TEST,
    STILL,
    TABLE_WINDOWS,
    TrialPass,
    combination,
    title,
)
from rig.results.metrics import Mare
from rig.tactile.contact.model_files import MODELS
from rig.tactile.estimators import ANGLENET, DEFAULT_ESTIMATOR, KOLAMURI, PAPER_WINDOW, TOSKOV
from rig.tactile.paper.axis import METHODS

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
PAPER_FOUR = {
    KOLAMURI: "4.39 ± 0.18 (other objects)",
    TOSKOV: "3.96 (other objects)",
    ANGLENET_ON_TEST: "3.23 ± 1.69",
    "PSPNet and skeleton": "1.85 ± 0.96",
}
"""The same, Table IV."""
KEPT = "table4.json"
"""Results of systems whose network is not shipped, as this benchmark measured them once."""


@dataclass(frozen=True, slots=True)
class TrialsResult:
    """Everything measured on the simulated lifts.

    scores: by method and window, over phase B. ms: median wall time per frame with contact, by method, one
    thread. frames: of phase B. missing: the paper's networks that were not given. session: the recorded
    lifts.
    """

    lifts: int
    frames: int
    scores: dict[tuple[str, int], ContenderScore]
    ms: dict[str, float]
    missing: tuple[str, ...]
    session: Path


def summarize(
    passes: Sequence[TrialPass], marked: Sequence[TrialPass], missing: tuple[str, ...], session: Path
) -> TrialsResult:
    """Combine the lifts. passes: on the plain gel; marked: on the gel with markers."""
    scores, ms = {}, {}
    for lifts in (passes, marked):
        scores |= {key: score_all([lift.scores[key] for lift in lifts]) for key in lifts[0].scores}
        spent_ms = {n: [ms for lift in lifts for ms in lift.contact_ms[n]] for n in lifts[0].contact_ms}
        ms |= {name: float(np.median(values)) for name, values in spent_ms.items() if values}
    return TrialsResult(len(passes), sum(lift.frames for lift in passes), scores, ms, missing, session)


def train_command(network: str) -> str:
    """Return the commands that train a network of the paper and use it in this benchmark."""
    return (
        f"rig train --arch {network} --fold D_s3 --units family --out RUN, "
        f"then --model {network}=RUN/{network}_D_s3/model.onnx"
    )


def table_three(result: TrialsResult) -> Table:
    """Return the MARE over phase B by network, angle method and window; the paper's in brackets."""
    rows = []
    for name, network in (*NETWORKS.items(), (OURS, OURS)):
        if name in result.missing:
            rows.append((network, f"not trained yet: {train_command(name)}", *[NONE] * 6))
        else:
            rows += [_three_row(result, network, method, combination(network, method)) for method in METHODS]
    rows.append(_three_row(result, DEFAULT_ESTIMATOR, "(ours)", DEFAULT_ESTIMATOR))
    columns = ("network", "method", *(f"window {n}" for n in TABLE_WINDOWS), "ms per frame with contact")
    return Table(f"{head(result)}: the paper's Table III (its figures in brackets)", columns, rows, left=2)


def table_four(result: TrialsResult) -> Table:
    """Return every system with its usual window, and the paper's result for it."""
    rows = []
    for name in systems(result):
        score = result.scores[name, usual_window(name)]
        time = NONE if name == STILL else _ms(result, name)
        rows.append((title(name), *_cells(score), time, PAPER_FOUR.get(name, NONE)))
    if ANGLENET_ON_TEST not in result.ms:
        rows.append(_kept_row())
    columns = (
        "system",
        "MARE",
        "95 % interval",
        "answered",
        "refused frames keep the last angle",
        "ms per frame with contact",
        "paper",
    )
    return Table(f"{head(result)}: the paper's Table IV", columns, rows)


def notes(result: TrialsResult) -> list[str]:
    """Return the conditions of the measurement, a sentence or two each."""
    return [
        "SIMULATED: the paper's figures are of its real bench and objects and cannot be compared with these.",
        f"One fingertip at 30 frames per second, {result.frames} frames of phase B; times in one process "
        "and one thread, medians.",
        "The angle methods are the corrected ones: they refuse a contact that is too round for an axis.",
        "Refused held: a frame without an answer counts with the last answer given.",
        "Kolamuri et al. runs on the same lifts with dots printed on the gel. The gel follows a rotation by "
        "at most 10 degrees; beyond that the object slides over it.",
        "Toskov et al. uses only the wrench at the wrist: light grips change its torque by some mN m, about "
        "the noise of the arm's sensor. It and AngleNet were trained on SIMULATED lifts of other objects.",
        "The shipped networks were trained on fold D_s3, whose training objects include 1 and 7, as in the "
        "paper.",
        f"Errors by object, edge against cylinder, and the curves of each lift: rig report {result.session}",
    ]


def usual_window(system: str) -> int:
    """Return the default window of a system: the paper's, or none."""
    return (
        1
        if system in (DEFAULT_ESTIMATOR, KOLAMURI, ANGLENET, ANGLENET_ON_TEST, TOSKOV, STILL)
        else PAPER_WINDOW
    )


def systems(result: TrialsResult) -> list[str]:
    """Return the systems in the order they ran."""
    return list(dict.fromkeys(name for name, _ in result.scores))


def head(result: TrialsResult) -> str:
    """Return a description of the data of the tables."""
    return f"SIMULATED, {counted(result.lifts, 'lift')}, one fingertip, phase B"


def _three_row(result: TrialsResult, network: str, method: str, system: str) -> tuple[str, ...]:
    paper = PAPER_THREE.get((network, method), (None,) * len(TABLE_WINDOWS))
    cells = [
        _mare(result.scores[system, window].mare) + (f" ({figure:.2f})" if figure else "")
        for window, figure in zip(TABLE_WINDOWS, paper, strict=True)
    ]
    return (network, method, *cells, _ms(result, system))


def _kept_row() -> tuple[str, ...]:
    """Return the stored result of AngleNet trained as in the paper; its network is not shipped."""
    text = (MODELS / KEPT).read_text(encoding="utf-8")
    kept = json.loads(text)[ANGLENET_ON_TEST]
    cells = (kept["mare"], kept["interval"], kept["answered"], kept["refused_held"], kept["ms"])
    return (f"{title(ANGLENET_ON_TEST)} (kept: {kept['of']})", *cells, PAPER_FOUR[ANGLENET_ON_TEST])


def _cells(score: ContenderScore) -> tuple[str, str, str, str]:
    mare = score.mare
    held = NONE if score.mare_held is None else f"{score.mare_held.mean_deg:.2f}"
    return _mare(mare), (mare and mare.beside) or NONE, f"{score.answered:.1%}", held


def _mare(mare: Mare | None) -> str:
    return NONE if mare is None else f"{mare.mean_deg:.2f} ± {mare.std_deg:.2f}"


def _ms(result: TrialsResult, name: str) -> str:
    ms = result.ms.get(name)
    if ms is None:
        return NONE
    return f"{ms:.1f}" if ms >= 10.0 else f"{ms:.2f}"
