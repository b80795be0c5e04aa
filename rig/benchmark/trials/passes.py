"""All systems on one lift as the paper compares: one fingertip, 30 frames per second, error over phase B.

A network segments each frame once for all angle methods, and windows are applied afterwards.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2

from drivers.clock import to_ns
from drivers.types import ArmState, Frame, Image
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import filtered
from rig.benchmark.estimators.lifts import RecordedLift, Tips, open_lift, truth_at
from rig.benchmark.estimators.scores import SeriesScore, score_series
from rig.config.models import TactileConfig
from rig.lift.object_angle import ZERO_S, object_angle
from rig.sessions.reading import recorded_arm_states
from rig.sessions.records import FinishedLift
from rig.tactile.contact.finder import Contact
from rig.tactile.contact.network import load_network
from rig.tactile.contact.segmenter import Segmenter
from rig.tactile.estimators import ANGLENET, DEFAULT_ESTIMATOR, KOLAMURI, TOSKOV, choose_estimator
from rig.tactile.paper.axis import METHODS
from rig.tactile.paper.estimator import AxisEstimator
from rig.tactile.peers.learned import AngleNetEstimator, ToskovEstimator
from rig.tactile.peers.networks import load_image_network, load_wrench_network
from rig.tactile.sample import SlipSample, State, TactileEstimator

PERIOD_S = 1.0 / 30.0
"""Period of the paper's sensors, to which the frames of faster sensors are thinned."""
JITTER_S = 0.003
TABLE_WINDOWS = (2, 4, 6, 8, 10)
"""Of the paper's Table III."""
WINDOWS = (1, *TABLE_WINDOWS)
ANGLENET_ON_TEST = "anglenet-on-test"
"""AngleNet as the paper trained it: on the lifts that it is then tested with."""
STILL = "still"
"""Always reports 0: the least that a system has to improve on."""
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
    STILL: "none: 0 all the time",
}


@dataclass(frozen=True, slots=True)
class TrialPass:
    """One lift. scores: by method and window, over phase B; frame_s: wall time per frame by method."""

    scores: dict[tuple[str, int], SeriesScore]
    frame_s: dict[str, list[float]]
    frames: int


class NetworkContact:
    """A network's contacts, found once per frame for several angle methods. cost_s: of the last one."""

    def __init__(self, segmenter: Segmenter) -> None:
        self._segmenter = segmenter
        self._of: Image | None = None
        self._found: Contact | None = None
        self.cost_s = 0.0

    def find(self, image: Image) -> Contact:
        """Return the contact in a frame; the same array is not segmented twice in a row."""
        if self._found is None or image is not self._of:
            began = perf_counter()
            self._of, self._found = image, self._segmenter.find(image)
            self.cost_s = perf_counter() - began
        return self._found


def title(system: str) -> str:
    """Return what tables call a system."""
    return TITLES.get(system, system)


def make_system(
    name: str, files: Mapping[str, Path], background: Image, tip: TactileConfig
) -> TactileEstimator:
    """Make a system for one fingertip, without a window. files: networks of `PEER_FILES` by system."""
    if name == STILL:
        return _Still()
    if name in (ANGLENET, ANGLENET_ON_TEST):
        return AngleNetEstimator(background, load_image_network(files.get(name)))
    if name == TOSKOV:
        return ToskovEstimator(background, tip.sign, load_wrench_network(files.get(name)))
    return choose_estimator(name, 1).make(background, tip.pixel_aspect, tip.sign)


class _Still(TactileEstimator):
    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Report 0."""
        return SlipSample(time_ns, State.TRACKING, 0.0)


def combination(network: str, method: str) -> str:
    """Return the name of a network with an angle method."""
    return f"{network} and {method}"


def pass_lift(
    folder: Path,
    tips: Tips,
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
    serial = next(iter(tips))
    lift = open_lift(folder, tips, row)
    background, frames = lift.backgrounds[serial], list(thinned(_until_hold(lift, serial)))
    states = [s for s in recorded_arm_states(lift.recording) if s.time_ns >= lift.phases[Phase.GRASP]]
    passes = {n: _timed(make_system(n, files, background, tips[serial]), frames, states) for n in systems}
    late = [f for f in frames if f.time_ns >= lift.phases[Phase.LIFT] - to_ns(ZERO_S)]
    for title, file in networks.items():
        passes |= _network_passes(title, Segmenter(load_network(file), background), late)
    truth = truth_at(lift, {n: samples for n, (samples, _) in passes.items()})
    scores = {
        (name, window): _scored(lift, tips[serial].sign, filtered(name, samples, window), truth)
        for name, (samples, _) in passes.items()
        for window in WINDOWS
    }
    in_b = sum(f.time_ns >= lift.phases[Phase.LIFT] for f in frames)
    return TrialPass(scores, {name: cost_s for name, (_, cost_s) in passes.items()}, in_b)


def thinned(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield frames that are at least about a thirtieth of a second apart."""
    last_ns: int | None = None
    for frame in frames:
        if last_ns is None or frame.time_ns - last_ns >= to_ns(PERIOD_S - JITTER_S):
            last_ns = frame.time_ns
            yield frame


def _until_hold(lift: RecordedLift, serial: str) -> Iterator[Frame]:
    return (f for f in lift.frames(serial) if f.time_ns < lift.phases[Phase.HOLD])


def _timed(
    estimator: TactileEstimator, frames: Sequence[Frame], states: Sequence[ArmState]
) -> tuple[list[SlipSample], list[float]]:
    """Run an estimator on the frames; before each frame it gets the arm's states until then."""
    samples, cost_s, waiting = [], [], deque(states)
    for frame in frames:
        began = perf_counter()
        while waiting and waiting[0].time_ns <= frame.time_ns:
            estimator.arm(waiting.popleft())
        samples.append(estimator.update(frame.image, frame.time_ns))
        cost_s.append(perf_counter() - began)
    return samples, cost_s


def _network_passes(
    title: str, segmenter: Segmenter, frames: Sequence[Frame]
) -> dict[str, tuple[list[SlipSample], list[float]]]:
    finder = NetworkContact(segmenter)
    estimators = {m: AxisEstimator(finder, METHODS[m]) for m in METHODS}
    passes: dict[str, tuple[list[SlipSample], list[float]]] = {
        combination(title, method): ([], []) for method in METHODS
    }
    for frame in frames:
        finder.find(frame.image)
        for method, estimator in estimators.items():
            samples, cost_s = passes[combination(title, method)]
            began = perf_counter()
            samples.append(estimator.update(frame.image, frame.time_ns))
            cost_s.append(finder.cost_s + perf_counter() - began)
    return passes


def _scored(
    lift: RecordedLift, sign: int, samples: Sequence[SlipSample], truth: Mapping[int, float | None]
) -> SeriesScore:
    """Score one fingertip's signed angle since the end of phase A."""
    lift_ns = lift.phases[Phase.LIFT]
    tip = object_angle({"": sign}, {"": samples}, lift_ns).tips[""]
    answers = [tip.answer(s) for s in samples if s.time_ns >= lift_ns]
    return score_series(
        f"{lift.row.object}/{lift.row.lift}",
        [a.angle_deg for a in answers],
        [a.sigma_deg for a in answers],
        [truth[s.time_ns] for s in samples if s.time_ns >= lift_ns],
    )
