"""All systems on one lift, compared as in the paper: one fingertip, 30 frames per second, error over phase B.

A network segments each frame once for all angle methods, and windows are applied afterwards.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from drivers.clock import to_ns
from drivers.types import Image
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import RecordedLift, SharedContact, filtered, open_lift, truth_at
from rig.frames.estimates import TimedSample, contact_ms, estimate_frames, estimate_together
from rig.frames.of_session import SessionSeries
from rig.frames.series import TimedFrame
from rig.lift.object_angle import ZERO_S, object_angle
from rig.results.scores import SeriesScore, score_series
from rig.sessions.reading import recorded_arm_states
from rig.sessions.records import FinishedLift
from rig.tactile.contact.network import load_network
from rig.tactile.contact.segmenter import Segmenter
from rig.tactile.estimators import ANGLENET, DEFAULT_ESTIMATOR, KOLAMURI, TOSKOV, choose_estimator
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator
from rig.tactile.peers.learned import (
    AngleNetEstimator,
    ToskovEstimator,
    load_image_network,
    load_wrench_network,
)
from rig.tactile.sample import SlipSample, State, TactileEstimator

PERIOD_S = 1.0 / 30.0
"""Period of the paper's sensors, to which the frames of faster sensors are thinned."""
JITTER_S = 0.003
TABLE_WINDOWS = (2, 4, 6, 8, 10)
"""Of the paper's Table III."""
WINDOWS = (1, *TABLE_WINDOWS)
ANGLENET_ON_TEST = "anglenet-on-test"
"""AngleNet trained as in the paper: on the same lifts on which it is tested."""
STILL = "still"
"""A baseline that always reports 0."""
PLAIN = (DEFAULT_ESTIMATOR, *METHODS, ANGLENET, TOSKOV, STILL)
"""Systems that run on the lifts of the gel without markers, beside the networks."""
PEER_FILES = (ANGLENET, ANGLENET_ON_TEST, TOSKOV)
"""Systems whose network may be given as a file."""
TITLES = {
    **{method: f"{method}, classical mask" for method in METHODS},
    KOLAMURI: "Kolamuri et al. (markers)",
    ANGLENET: "AngleNet, objects held back",
    ANGLENET_ON_TEST: "AngleNet, trained on these lifts",
    TOSKOV: "Toskov et al. (wrist), objects held back",
    STILL: "none: always 0",
}

Passes = dict[str, list[TimedSample]]
"""Samples by system."""


@dataclass(frozen=True, slots=True)
class TrialPass:
    """One lift. scores: by method and window, over phase B.

    contact_ms: wall time of each frame with contact, by method. frames: of phase B.
    """

    scores: dict[tuple[str, int], SeriesScore]
    contact_ms: dict[str, list[float]]
    frames: int


def title(system: str) -> str:
    """Return the name of a system in tables."""
    return TITLES.get(system, system)


def make_system(name: str, files: Mapping[str, Path], tip: SessionSeries) -> TactileEstimator:
    """Make a system for one fingertip, without a window. files: networks of `PEER_FILES` by system."""
    if name == STILL:
        return _Still()
    if name in (ANGLENET, ANGLENET_ON_TEST):
        return AngleNetEstimator(tip.background, load_image_network(files.get(name)))
    if name == TOSKOV:
        return ToskovEstimator(tip.background, tip.sign, load_wrench_network(files.get(name)))
    return choose_estimator(name, 1).make(tip.background, tip.aspect, tip.sign)


class _Still(TactileEstimator):
    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Report 0."""
        return SlipSample(time_ns, State.TRACKING, 0.0)


def combination(network: str, method: str) -> str:
    """Return the name of a network with an angle method."""
    return f"{network} and {method}"


def pass_lift(
    folder: Path,
    networks: Mapping[str, str],
    systems: Sequence[str],
    files: Mapping[str, Path],
    row: FinishedLift,
) -> TrialPass:
    """Run networks and systems over one stored lift of the first fingertip.

    networks: shipped name or file by its title in the table. files: see `make_system`. Raises `InputError`
    for a network that cannot be loaded, `SessionError` for a damaged recording.
    """
    cv2.setNumThreads(1)
    lift = open_lift(folder, row)
    tip = next(iter(lift.tips.values()))
    frames = list(thinned(f for f in tip.frames if f.time_ns < lift.phases[Phase.HOLD]))
    states = [s for s in recorded_arm_states(lift.recording) if s.time_ns >= lift.phases[Phase.GRASP]]
    made = {name: make_system(name, files, tip) for name in systems}
    passes: Passes = {name: list(estimate_frames(of, frames, states)) for name, of in made.items()}
    late = [f for f in frames if f.time_ns >= lift.phases[Phase.LIFT] - to_ns(ZERO_S)]
    for title, file in networks.items():
        passes |= _network_passes(title, Segmenter(load_network(file), tip.background), late)
    samples = {name: [of.sample for of in timed] for name, timed in passes.items()}
    truth = truth_at(lift, samples)
    scores = {
        (name, window): _scored(lift, tip.sign, filtered(name, of, window), truth)
        for name, of in samples.items()
        for window in WINDOWS
    }
    in_b = sum(f.time_ns >= lift.phases[Phase.LIFT] for f in frames)
    return TrialPass(scores, {n: contact_ms(timed) for n, timed in passes.items()}, in_b)


def thinned(frames: Iterable[TimedFrame]) -> Iterator[TimedFrame]:
    """Yield frames that are at least about a thirtieth of a second apart."""
    last_ns: int | None = None
    for frame in frames:
        if last_ns is None or frame.time_ns - last_ns >= to_ns(PERIOD_S - JITTER_S):
            last_ns = frame.time_ns
            yield frame


def _network_passes(title: str, segmenter: Segmenter, frames: Sequence[TimedFrame]) -> Passes:
    """Run all angle methods on a network's contacts; the network's time counts for each of them."""
    finder = SharedContact(segmenter)
    estimators = {combination(title, m): AxisEstimator(finder, METHODS[m]) for m in METHODS}

    def segmented() -> Iterator[TimedFrame]:
        for frame in frames:
            if frame.image is not None:
                finder.find(frame.image)
            yield frame

    passes = estimate_together(estimators, segmented())
    return {
        name: [replace(of, cost_s=(of.cost_s or 0.0) + s) for of, s in zip(timed, finder.cost_s, strict=True)]
        for name, timed in passes.items()
    }


def _scored(
    lift: RecordedLift, sign: int, samples: Sequence[SlipSample], truth: Mapping[int, float | None]
) -> SeriesScore:
    """Score one fingertip's signed angle since the end of phase A."""
    lift_ns = lift.phases[Phase.LIFT]
    tip = object_angle({"": sign}, {"": samples}, lift_ns).tips[""]
    answers = [tip.answer(s) for s in samples if s.time_ns >= lift_ns]
    return score_series(
        lift.name,
        [a.angle_deg for a in answers],
        [a.sigma_deg for a in answers],
        [truth[s.time_ns] for s in samples if s.time_ns >= lift_ns],
    )
