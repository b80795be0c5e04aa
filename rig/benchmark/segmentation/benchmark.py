"""`rig benchmark segmentation`: how well and how fast contacts are found, and the limits that has to keep."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from drivers.types import Image
from fakes.studio.hard_frames import hard_frames
from rig.benchmark.measured import Measured, at_least, at_most, not_there
from rig.benchmark.segmentation.panels import Panels, read_panels
from rig.frames.masks import CLASSICAL, FrameSegmenter, SegmentChoice, make_segmenter, segmenter_maker
from rig.labels.scores import agreement
from rig.tactile.contact.network import SHIPPED, Network, load_network
from rig.tactile.contact.network_input import NetworkInput, compared_planes, frame_planes
from rig.tactile.contact.relative import RelativeDifference
from rig.training.examples import Examples
from rig.training.simulated import examples_of, simulated_examples

HELD_OUT = ("2", "12", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
"""The test objects of fold D_s3, and the trial objects: no shipped network was trained on them."""
FRAME_SIZE = (240, 320)
LEAST_DICE, LEAST_IOU = 0.97, 0.94
LEAST_UNLIKE_DICE = 0.90
"""On frames unlike all that a network was trained on: real ones, and hard lifts."""
MOST_MS, MOST_SHARE, MOST_LOSS = 3.0, 0.1, 0.005
TIMED_FRAMES, WARM_UP_FRAMES, TURN_FRAMES = 200, 20, 10
RANDOMISED, FAMILY = "SIMULATED, units unlike one another", "SIMULATED, units of the bench"
HARD, REAL = "SIMULATED, hard lifts", "nine real frames"


@dataclass(frozen=True, slots=True)
class MethodScore:
    """A method on a set of frames: mean and standard deviation over frames."""

    method: str
    data: str
    frames: int
    dice: float
    dice_std: float
    iou: float
    iou_std: float


@dataclass(frozen=True, slots=True)
class MethodTime:
    """Median and 99th percentile, ms, of frame in to mask out, and the median of the network alone.

    size_px: (width, height) at which a network looks.
    """

    method: str
    size_px: tuple[int, int] | None
    frame_ms: float
    frame_p99_ms: float
    network_ms: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SegmentationReport:
    """Everything that was measured; panels: the real frames with each method's masks, None without."""

    scores: tuple[MethodScore, ...]
    times: tuple[MethodTime, ...]
    limits: tuple[Measured, ...]
    panels: Panels | None
    masks: dict[str, list[Image]]

    @property
    def passed(self) -> bool:
        """Whether every limit that could be measured holds."""
        return all(limit.met is not False for limit in self.limits)


def run_segmentation(
    frames: int, seed: int, data: Path | None, models: Mapping[str, Path], say: Callable[[str], None]
) -> SegmentationReport:
    """Measure the shipped networks, others, and the classical mask.

    data: folder of real recordings, or None. models: files of networks by name, beside the shipped
    ones or instead of them.
    """
    methods = {
        **{name: name for name in SHIPPED},
        **{name: str(file) for name, file in models.items()},
        CLASSICAL: CLASSICAL,
    }
    cv2.setNumThreads(1)
    say(f"rendering {frames} SIMULATED frames of objects never trained on")
    randomised = simulated_examples(HELD_OUT, frames, seed + 1, FRAME_SIZE)
    family = simulated_examples(HELD_OUT, frames // 2, seed + 2, FRAME_SIZE, family=True)
    hard = examples_of(hard_frames(HELD_OUT, seed + 3), frames // 2, FRAME_SIZE)
    scores, masks = [], {}
    panels = None if data is None else read_panels(data)
    for method, model in methods.items():
        say(f"measuring: {method}")
        sets = {RANDOMISED: randomised, FAMILY: family, HARD: hard}
        scores += [score_examples(method, model, title, examples) for title, examples in sets.items()]
        if panels is not None:
            segmenter = make_segmenter(SegmentChoice(model), panels.background)
            masks[method] = [_mask(segmenter, frame) for frame in panels.frames]
            scores.append(_scored(method, REAL, masks[method], panels.labels))
    say("measuring: run time, methods turn about, one thread")
    times = measure_times(methods, randomised)
    limits = (*_limits(scores, times), _threads_agree(methods["ours"], randomised))
    return SegmentationReport(tuple(scores), tuple(times), limits, panels, masks)


def score_examples(method: str, model: str, title: str, examples: Examples) -> MethodScore:
    """Segment every frame with its own background, and compare with its label.

    method, title: names of the network and of the frames. model: as in `SegmentChoice`.
    """
    make = segmenter_maker(SegmentChoice(model))
    masks = [
        _mask(make(background), frame)
        for frame, background in zip(examples.frames, examples.backgrounds, strict=True)
    ]
    return _scored(method, title, masks, [np.where(label > 127, 255, 0) for label in examples.labels])


def measure_times(methods: Mapping[str, str], examples: Examples) -> list[MethodTime]:
    """Time the methods turn about on the frames of one unit, each on one thread. methods: models by name.

    A turn is a few frames: a rig runs one method on a stream of frames, so what the others leave in the
    processor's caches is no cost of it.
    """
    background = examples.backgrounds[0]
    pairs = zip(examples.frames, examples.backgrounds, strict=True)
    frames = [frame for frame, its_own in pairs if np.array_equal(its_own, background)]
    segmenters = {
        method: make_segmenter(SegmentChoice(model), background) for method, model in methods.items()
    }
    networks = {method: load_network(model) for method, model in methods.items() if model != CLASSICAL}
    calls = {method: _network_call(network, background) for method, network in networks.items()}
    frame_s: dict[str, list[float]] = {method: [] for method in methods}
    network_s: dict[str, list[float]] = {method: [] for method in networks}
    for first in range(0, WARM_UP_FRAMES + TIMED_FRAMES, TURN_FRAMES):
        turn = [frames[number % len(frames)] for number in range(first, first + TURN_FRAMES)]
        for method, segmenter in segmenters.items():
            frame_s[method] += [_cost_s(lambda s=segmenter, f=frame: s.segment(f)) for frame in turn]
        for method, call in calls.items():
            network_s[method] += [call(frame) for frame in turn]
    return [
        MethodTime(
            method,
            networks[method].size if method in networks else None,
            1e3 * float(np.median(costs[WARM_UP_FRAMES:])),
            1e3 * float(np.percentile(costs[WARM_UP_FRAMES:], 99)),
            1e3 * float(np.median(network_s[method][WARM_UP_FRAMES:])) if method in network_s else None,
        )
        for method, costs in frame_s.items()
    ]


def _network_call(network: Network, background: Image) -> Callable[[Image], float]:
    """Return what gives the cost of the network alone, in s, for a frame."""
    compare = network.recipe.inputs is NetworkInput.FRAME_AND_DIFFERENCE
    reference = RelativeDifference(background, network.size)

    def call(frame: Image) -> float:
        planes = compared_planes(frame, reference) if compare else frame_planes(frame, network.size)
        return _cost_s(lambda: network.logits(planes))

    return call


def _cost_s(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began


def _mask(segmenter: FrameSegmenter, frame: Image) -> Image:
    mask = segmenter.segment(frame).contact.mask
    return np.zeros(frame.shape[:2], np.uint8) if mask is None else mask


def _scored(method: str, data: str, masks: Sequence[Image], labels: Sequence[Image]) -> MethodScore:
    found = [agreement(mask, label) for mask, label in zip(masks, labels, strict=True)]
    dice, iou = np.array([(one.dice, one.iou) for one in found]).T
    return MethodScore(
        method, data, len(found), float(dice.mean()), float(dice.std()), float(iou.mean()), float(iou.std())
    )


def _limits(scores: list[MethodScore], times: list[MethodTime]) -> list[Measured]:
    by = {(score.method, score.data): score for score in scores}
    time = {row.method: row for row in times}
    ours, full, real = by["ours", RANDOMISED], by["ours-full", RANDOMISED], by.get(("ours", REAL))
    shares = (time["ours"].network_ms or 0.0) / (time["pspnet"].network_ms or np.inf)
    name = "ours, nine real frames: Dice"
    return [
        at_least("ours, SIMULATED objects never trained on: Dice", ours.dice, LEAST_DICE),
        at_least("ours, SIMULATED objects never trained on: IoU", ours.iou, LEAST_IOU),
        at_least("ours, SIMULATED hard lifts: Dice", by["ours", HARD].dice, LEAST_UNLIKE_DICE),
        at_most("ours, frame in to mask out, one thread, ms (median)", time["ours"].frame_ms, MOST_MS),
        at_most("ours, the network's run time as a share of PSPNet's", shares, MOST_SHARE),
        at_most("eight-bit against full, difference of Dice", abs(ours.dice - full.dice), MOST_LOSS),
        not_there(name) if real is None else at_least(name, real.dice, LEAST_UNLIKE_DICE),
    ]


def _threads_agree(model: str, examples: Examples) -> Measured:
    """Pixels in which masks made with one and with two threads differ."""
    apart = 0
    makers = [segmenter_maker(SegmentChoice(model, threads=count)) for count in (1, 2)]
    for frame, background in list(zip(examples.frames, examples.backgrounds, strict=True))[:30]:
        one, two = (_mask(make(background), frame) for make in makers)
        apart += int(np.count_nonzero(one != two))
    return at_most("ours, pixels in which 1 and 2 threads differ, 30 frames", apart, 0)
