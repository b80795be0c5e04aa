"""`rig benchmark trials`: the paper's Tables III and IV on the same simulated lifts in one run.

All systems are compared as in the paper: one fingertip, 30 frames per second, error over phase B. A network
segments each frame once for all angle methods, and windows are applied afterwards.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import to_ns
from drivers.errors import plural
from drivers.types import Image
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import (
    ContenderScore,
    SharedContact,
    filter_samples,
    open_lift,
    score_all,
)
from rig.benchmark.estimators.study import record
from rig.benchmark.harness import Report, Run, Study, Table
from rig.benchmark.measured import NONE
from rig.benchmark.segmentation import NETWORKS, OURS, parse_models
from rig.config import load_bench
from rig.declared import option
from rig.experiments.trial import resolve_objects
from rig.frames.estimates import contact_ms, estimate_frames, estimate_together
from rig.frames.of_session import SessionSeries
from rig.frames.series import TimedFrame
from rig.lift.object_angle import ZERO_S, object_angle
from rig.results.metrics import Mare
from rig.results.scores import SeriesScore, score_series
from rig.sessions.reading import phase_times, recorded_arm_states
from rig.sessions.records import Lift
from rig.sessions.rows import read_finished_lifts
from rig.tactile.angles import Angles
from rig.tactile.contact.model_files import MODELS
from rig.tactile.contact.network import load_network
from rig.tactile.contact.segmenter import Segmenter
from rig.tactile.estimators import (
    ANGLENET,
    DEFAULT_ESTIMATOR,
    KOLAMURI,
    PAPER_WINDOW,
    TOSKOV,
    choose_estimator,
)
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator
from rig.tactile.peers import learned
from rig.tactile.sample import SlipSample, State, TactileEstimator

PERIOD_S, JITTER_S = 1.0 / 30.0, 0.003
"""Period of the paper's sensors, to which the frames of faster sensors are thinned, and its tolerance."""
TABLE_WINDOWS = (2, 4, 6, 8, 10)  # of the paper's Table III
WINDOWS = (1, *TABLE_WINDOWS)
ANGLENET_ON_TEST = "anglenet-on-test"
"""AngleNet trained as in the paper: on the same lifts on which it is tested."""
STILL = "still"  # a baseline that always reports 0
PLAIN = (DEFAULT_ESTIMATOR, *METHODS, ANGLENET, TOSKOV, STILL)
"""Systems that run on the lifts of the gel without markers, beside the networks."""
PEER_FILES = (ANGLENET, ANGLENET_ON_TEST, TOSKOV)  # systems whose network may be given as a file
UNFILTERED = (DEFAULT_ESTIMATOR, KOLAMURI, ANGLENET, ANGLENET_ON_TEST, TOSKOV, STILL)
"""Systems without a window by default; the others have the paper's."""
TITLES = {
    **{method: f"{method}, classical mask" for method in METHODS},
    KOLAMURI: "Kolamuri et al. (markers)",
    ANGLENET: "AngleNet, objects held back",
    ANGLENET_ON_TEST: "AngleNet, trained on these lifts",
    TOSKOV: "Toskov et al. (wrist), objects held back",
    STILL: "none: always 0",
}
"""Systems in tables; those that are not listed have their names there."""
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
KEPT = "table4.json"  # results of systems whose network is not shipped, as this benchmark measured them once

Passes = dict[str, list[SlipSample]]  # samples by system
TrialPass = tuple[dict[tuple[str, int], SeriesScore], dict[str, list[float]], int]
"""One lift: scores over phase B by method and window, wall times of the frames with contact by method, ms,
and the number of frames of phase B."""


@dataclass(frozen=True, slots=True)
class TrialsOptions:
    model: list[str] | None = option(
        None,
        "NAME=FILE: a network of rig train (pspnet, deeplabv3plus, unetplusplus, ours) or "
        "tools/train_angle.py (anglenet, anglenet-on-test, toskov) beside the shipped ones; repeat for more.",
    )
    lifts: int = option(5, "Lifts of each object.", min=1, max=100)
    objects: list[str] | None = option(None, "Only this object; repeat for more.", "--object")


Scores = dict[tuple[str, int], ContenderScore]  # by system and window, over phase B
Times = dict[str, float]  # median wall time per frame with contact, ms, by system, one thread


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
    plain = record(run, "session", bench, choose_estimator(DEFAULT_ESTIMATOR), *what)
    tips = tuple(tip.model_copy(update={"markers": True}) for tip in bench.tactile)
    dotted = bench.model_copy(update={"tactile": tips})
    marked = record(run, "session-markers", dotted, choose_estimator(KOLAMURI), *what)

    def passes(folder: Path, networks: dict[str, str], systems: Sequence[str]) -> list[TrialPass]:
        work = partial(pass_lift, folder, networks, systems, peers)
        rows = read_finished_lifts(folder)
        # one process, so that times can be compared
        return run.each(work, rows, lambda row: f"{row.object}/{row.lift}", workers=1)

    missing = tuple(name for name, title in NETWORKS.items() if title not in networks)
    scores, ms, of_plain = {}, {}, passes(plain, networks, systems)
    for lifts in (of_plain, passes(marked, {}, (KOLAMURI,))):
        scored, timed, _ = zip(*lifts, strict=True)
        scores |= {key: score_all([of[key] for of in scored]) for key in scored[0]}
        spent_ms = {name: [each for of in timed for each in of[name]] for name in timed[0]}
        ms |= {name: float(np.median(values)) for name, values in spent_ms.items() if values}
    frames = sum(count for *_, count in of_plain)
    rows = [
        {"system": name, "window": window, "ms": ms[name], **asdict(score)}
        for (name, window), score in scores.items()
    ]
    figures = {"lifts": len(of_plain), "frames": frames, "systems": rows, "not_trained": missing}
    title = f"SIMULATED, {plural(len(of_plain), 'lift')}, one fingertip, phase B: the paper's Table"
    tables = table_three(title, scores, ms, missing), table_four(title, scores, ms)
    return Report(tables, notes=_notes(frames, plain), figures=figures)


class _Still(TactileEstimator):
    def update(self, image: Image, time_ns: int) -> SlipSample:
        return SlipSample(time_ns, State.TRACKING, 0.0)


def _make_system(name: str, files: Mapping[str, Path], tip: SessionSeries) -> TactileEstimator:
    """Make a system for one fingertip, without a window. files: networks of `PEER_FILES` by system."""
    if name == STILL:
        return _Still()
    if name in (ANGLENET, ANGLENET_ON_TEST):
        return learned.AngleNetEstimator(tip.background, learned.load_image_network(files.get(name)))
    if name == TOSKOV:
        return learned.ToskovEstimator(tip.background, tip.sign, learned.load_wrench_network(files.get(name)))
    return choose_estimator(name, 1).make(tip.background, tip.aspect, tip.sign)


def pass_lift(
    folder: Path,
    networks: Mapping[str, str],
    systems: Sequence[str],
    files: Mapping[str, Path],
    row: Lift,
) -> TrialPass:
    """Run networks and systems over one stored lift of the first fingertip.

    networks: shipped name or file by its title in the table. files: networks of `PEER_FILES` by system.
    Raises `InputError` for a network that cannot be loaded, `SessionError` for a damaged recording.
    """
    cv2.setNumThreads(1)
    recording = folder / row.recording
    lift, grasp_ns = open_lift(recording, f"{row.object}/{row.lift}"), phase_times(recording)[Phase.GRASP]
    tip = next(iter(lift.tips.values()))
    frames = list(thin(f for f in tip.frames if f.time_ns < lift.hold_ns))
    states = [s for s in recorded_arm_states(recording) if s.time_ns >= grasp_ns]
    made = {name: _make_system(name, files, tip) for name in systems}
    passes: Passes = {name: list(estimate_frames(of, frames, states)) for name, of in made.items()}
    late = [f for f in frames if f.time_ns >= lift.lift_ns - to_ns(ZERO_S)]
    for title, file in networks.items():
        passes |= _network_passes(title, Segmenter(load_network(file), tip.background), late)
    scores = {}
    for name, window in product(passes, WINDOWS):
        samples = filter_samples(name, passes[name], window)
        track = object_angle({"": tip.sign}, {"": samples}, lift.lift_ns).tips[""]
        angles = Angles.of(track.answer(s) for s in samples if s.time_ns >= lift.lift_ns)
        true_deg = lift.truth.at(angles.time_s)
        scores[name, window] = score_series(lift.name, angles.angle_deg, angles.sigma_deg, true_deg)
    in_b = sum(f.time_ns >= lift.lift_ns for f in frames)
    return scores, {n: contact_ms(timed) for n, timed in passes.items()}, in_b


def thin(frames: Iterable[TimedFrame]) -> Iterator[TimedFrame]:
    last_ns: int | None = None
    for frame in frames:
        if last_ns is None or frame.time_ns - last_ns >= to_ns(PERIOD_S - JITTER_S):
            last_ns = frame.time_ns
            yield frame


def _network_passes(title: str, segmenter: Segmenter, frames: Sequence[TimedFrame]) -> Passes:
    """Run all angle methods on a network's contacts; the network's time counts for each of them."""
    finder = SharedContact(segmenter)
    estimators = {f"{title} and {m}": AxisEstimator(finder, METHODS[m]) for m in METHODS}

    def segment() -> Iterator[TimedFrame]:
        for frame in frames:
            if frame.image is not None:
                finder.find(frame.image)
            yield frame

    passes = estimate_together(estimators, segment())
    return {
        name: [replace(of, cost_s=(of.cost_s or 0.0) + s) for of, s in zip(timed, finder.cost_s, strict=True)]
        for name, timed in passes.items()
    }


def table_three(title: str, scores: Scores, times_ms: Times, missing: Sequence[str]) -> Table:
    """Return the MARE over phase B by network, angle method and window; the paper's in brackets.

    missing: the paper's networks that were not given.
    """

    def cells(network: str, method: str, system: str) -> tuple[str, ...]:
        paper = PAPER_THREE.get((network, method), (None,) * len(TABLE_WINDOWS))
        mares = [
            _mare(scores[system, window].mare) + (f" ({figure:.2f})" if figure else "")
            for window, figure in zip(TABLE_WINDOWS, paper, strict=True)
        ]
        return (network, method, *mares, _time(times_ms, system))

    rows = []
    for name, network in (*NETWORKS.items(), (OURS, OURS)):
        if name in missing:
            train = f"rig train --arch {name} --fold D_s3 --units family --out RUN, "
            train += f"then --model {name}=RUN/{name}_D_s3/model.onnx"
            rows.append((network, f"not trained yet: {train}", *[NONE] * 6))
        else:
            rows += [cells(network, method, f"{network} and {method}") for method in METHODS]
    rows.append(cells(DEFAULT_ESTIMATOR, "(ours)", DEFAULT_ESTIMATOR))
    columns = ("network", "method", *(f"window {n}" for n in TABLE_WINDOWS), "ms per frame with contact")
    return Table(f"{title} III (its figures in brackets)", columns, rows, left=2)


def _mare(mare: Mare | None) -> str:
    return NONE if mare is None else f"{mare.mean_deg:.2f} ± {mare.std_deg:.2f}"


def _time(times_ms: Times, system: str) -> str:
    ms = times_ms.get(system)
    return NONE if ms is None else f"{ms:.1f}" if ms >= 10.0 else f"{ms:.2f}"


def table_four(title: str, scores: Scores, times_ms: Times) -> Table:
    """Return every system with its usual window, and the paper's result for it."""
    rows = []
    for name in dict.fromkeys(name for name, _ in scores):
        score = scores[name, 1 if name in UNFILTERED else PAPER_WINDOW]
        held = NONE if score.mare_held is None else f"{score.mare_held.mean_deg:.2f}"
        interval = (score.mare and score.mare.beside) or NONE
        time = NONE if name == STILL else _time(times_ms, name)
        cells = (_mare(score.mare), interval, f"{score.answered:.1%}", held, time)
        rows.append((TITLES.get(name, name), *cells, PAPER_FOUR.get(name, NONE)))
    if ANGLENET_ON_TEST not in times_ms:
        kept = json.loads((MODELS / KEPT).read_text(encoding="utf-8"))[ANGLENET_ON_TEST]
        cells = (kept["mare"], kept["interval"], kept["answered"], kept["refused_held"], kept["ms"])
        trained = f"{TITLES[ANGLENET_ON_TEST]} (kept: {kept['of']})"
        rows.append((trained, *cells, PAPER_FOUR[ANGLENET_ON_TEST]))
    held, time = "refused frames keep the last angle", "ms per frame with contact"
    columns = ("system", "MARE", "95 % interval", "answered", held, time, "paper")
    return Table(f"{title} IV", columns, rows)


def _notes(frames: int, session: Path) -> list[str]:
    return [
        "SIMULATED: the paper's figures are of its real bench and objects and cannot be compared with these.",
        f"One fingertip at 30 frames per second, {frames} frames of phase B; times in one process "
        "and one thread, medians.",
        "The angle methods are the corrected ones: they refuse a contact that is too round for an axis.",
        "Refused held: a frame without an answer counts with the last answer given.",
        "Kolamuri et al. runs on the same lifts with dots printed on the gel. The gel follows a rotation by "
        "at most 10 degrees; beyond that the object slides over it.",
        "Toskov et al. uses only the wrench at the wrist: light grips change its torque by some mN m, about "
        "the noise of the arm's sensor. It and AngleNet were trained on SIMULATED lifts of other objects.",
        "The shipped networks were trained on fold D_s3, whose training objects include 1 and 7, as in the "
        "paper.",
        f"Errors by object, edge against cylinder, and the curves of each lift: rig report {session}",
    ]


STUDY = Study("trials", TrialsOptions, measure, "lifts", ("out", "jobs", "seed"), keeps_results=True)
