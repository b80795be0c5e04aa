"""`rig benchmark segmentation`: accuracy and run time of contact masks of networks and image processing."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from drivers.errors import InputError
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.training_frames import hard_frames
from rig.benchmark.harness import Report, Run, Study, Table, column, table_of
from rig.benchmark.measured import Measured, at_least, at_most, data_folder, informative, not_there
from rig.calibrate.press_folder import read_circled
from rig.declared import option
from rig.frames.masks import CLASSICAL, FrameSegmenter, SegmentChoice, make_segmenter, segmenter_maker
from rig.tactile.contact.background import auto_background
from rig.tactile.contact.network import SHIPPED, NetworkInput, compared_planes, frame_planes, load_network
from rig.tactile.contact.relative import RelativeDifference
from rig.training.examples import Examples, examples_of, simulated_examples
from rig.training.scores import score_masks

NETWORKS = {"deeplabv3plus": "DeepLabV3+", "unetplusplus": "UNet++", "pspnet": "PSPNet"}
"""The paper's networks by their names in `rig train`, in the order of the paper."""
OURS = "ours"
FOLDS = ("D_s1", "D_s2", "D_s3")
PAPER = {
    ("UNet++", "D_s1"): ("0.950 ± 0.018", "0.906 ± 0.033"),
    ("UNet++", "D_s2"): ("0.955 ± 0.008", "0.915 ± 0.015"),
    ("UNet++", "D_s3"): ("0.969 ± 0.006", "0.940 ± 0.011"),
    ("DeepLabV3+", "D_s1"): ("0.947 ± 0.020", "0.899 ± 0.036"),
    ("DeepLabV3+", "D_s2"): ("0.951 ± 0.012", "0.906 ± 0.021"),
    ("DeepLabV3+", "D_s3"): ("0.969 ± 0.007", "0.937 ± 0.013"),
    ("PSPNet", "D_s1"): ("0.937 ± 0.026", "0.883 ± 0.045"),
    ("PSPNet", "D_s2"): ("0.953 ± 0.009", "0.910 ± 0.017"),
    ("PSPNet", "D_s3"): ("0.963 ± 0.008", "0.929 ± 0.014"),
}
"""Castano-Amoros and Gil 2023, Table II: Dice and IoU on the paper's own real frames."""
HELD_OUT = ("2", "12", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
"""The test objects of fold D_s3, and the trial objects; no network of the rig was trained on them."""
FRAME_SIZE = (240, 320)
LEAST_DICE, LEAST_IOU = 0.97, 0.94
LEAST_UNLIKE_DICE = 0.90  # limit for frames that differ from the training data: real frames and hard lifts
LEAST_PRESS_IOU = 0.70  # limit for presses of a ball on a real sensor that no network was trained on
MOST_SHARE, MOST_LOSS = 0.1, 0.005
TIMED_FRAMES, WARM_UP_FRAMES, TURN_FRAMES, THREADED_FRAMES = 200, 20, 10, 30
RANDOMISED, FAMILY = "SIMULATED, units unlike one another", "SIMULATED, units of the bench"
HARD, REAL, PRESSES = "SIMULATED, hard lifts", "nine real frames", "real presses"
PANELS, PANEL_COUNT = Path("aurova_figures") / "panels", 9
"""Real DIGIT frames of one sensor with human labels, for scoring only."""


@dataclass(frozen=True, slots=True)
class SegmentationOptions:
    model: list[str] | None = option(
        None,
        "Network of rig train or rig model import to add or to replace, as NAME=FILE (NAME: pspnet, "
        "deeplabv3plus, unetplusplus or ours); repeat for more.",
    )
    frames: int = option(360, "Number of simulated test frames.", min=24)
    presses: list[Path] | None = option(
        None,
        "Folder with photographs of balls pressed into a real gel, background.png and circles.csv (frame, "
        "center_x, center_y, radius in px, drawn by hand); repeat for more sensors.",
    )


@dataclass(frozen=True, slots=True)
class MeanStd:
    mean: float
    std: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.std:.3f}"


@dataclass(frozen=True, slots=True)
class TrainedRow:
    """Results of a network trained on one fold, and those of the paper."""

    network: str = column("network")
    fold: str = column("fold")
    dice: MeanStd | None = column("Dice", lambda dice: "not trained yet" if dice is None else str(dice))
    iou: MeanStd | None = column("IoU")
    used: float | None = column(
        "Dice as used", ".3f", "with the parts that the network missed, as in rig segment"
    )
    ms: float | None = column("ms", ".1f", "frame in to mask out, in the training's run")
    trained: str | None = column("trained (images x epochs)", doc="settings, size of the network's input")
    paper_dice: str | None = column("paper's Dice")
    paper_iou: str | None = column("paper's IoU")


@dataclass(frozen=True, slots=True)
class MethodScore:
    """Dice and IoU of a method on a set of frames, and the size of its masks relative to the labels."""

    method: str = column("method")
    data: str = column("data")
    frames: int = column("frames")
    dice: MeanStd = column("Dice")
    iou: MeanStd = column("IoU")
    size_ratio: float | None = column("size ratio", ".3f", "median root of mask area over label area")


@dataclass(frozen=True, slots=True)
class MethodTime:
    method: str = column("method")
    size_px: str | None = column("network's input, px", doc="width x height")
    frame_ms: float = column("frame in to mask out, ms", ".2f", "median")
    frame_p99_ms: float = column("99 %, ms", ".2f")
    network_ms: float | None = column("network alone, ms", ".2f", "median")


def measure(options: SegmentationOptions, run: Run) -> Report:
    """Score the segmentation networks on SIMULATED objects and on real frames.

    The networks were not trained on these objects. Nine real frames with labels are used if they are
    available; photographs of pressed balls are given with --presses. The command prints the paper's Table II
    with the stored results of rig train --all, the new measurements, and the limits. Simulated figures are
    marked SIMULATED. The exit code is 4 if a limit is missed.

    Examples:
      rig benchmark segmentation
      rig benchmark segmentation --frames 1000 --out segmentation --json
      rig benchmark segmentation --model unetplusplus=runs/unetplusplus_D_s3/model.onnx
      rig benchmark segmentation --presses D20641 --presses D20654
    """
    given = parse_models(options.model or [], (*NETWORKS, OURS))
    shipped = {name: name for name in SHIPPED}
    named = {**shipped, **{name: str(file) for name, file in given.items()}, CLASSICAL: CLASSICAL}
    models = {name: SegmentChoice(model) for name, model in named.items()}
    alone = {f"{OURS}, network alone": SegmentChoice(named[OURS], alone=True)}
    data = data_folder()
    real = {REAL: read_panels(data / PANELS)} if data and (data / PANELS).is_dir() else {}
    real |= {f"{PRESSES}, {folder.name}": read_presses(folder) for folder in options.presses or ()}
    cv2.setNumThreads(1)
    run.say(f"rendering {options.frames} SIMULATED frames of objects that are not in the training data")
    half = options.frames // 2
    sets = {
        RANDOMISED: simulated_examples(HELD_OUT, options.frames, run.seed + 1, FRAME_SIZE),
        FAMILY: simulated_examples(HELD_OUT, half, run.seed + 2, FRAME_SIZE, family=True),
        HARD: examples_of(hard_frames(HELD_OUT, run.seed + 3), half, FRAME_SIZE),
        **real,
    }

    def score(method: str) -> list[MethodScore]:
        choice = (models | alone)[method]
        return [score_examples(method, choice, title, of) for title, of in sets.items()]

    # one worker, in this process, because the simulated frames are in its memory
    scores = [row for of in run.each(score, [*models, *alone], workers=1) for row in of]
    run.say("measuring run time: methods alternate, one thread")
    times = measure_times(models, sets[RANDOMISED])
    title = f"Run time, one thread, {FRAME_SIZE[0]} x {FRAME_SIZE[1]} px, median, methods turn about"
    return Report(
        tables=(
            table_two(),
            table_of("Contacts found, shipped networks", scores, left=2),
            table_of(title, times),
        ),
        limits=(*_limits(scores, times), _threads_agree(named[OURS], sets[RANDOMISED])),
        limits_of="the shipped networks",
    )


def trained_models() -> list[dict[str, Any]]:
    return json.loads((files("rig") / "models" / "table2.json").read_text(encoding="utf-8"))["models"]


def table_two() -> Table:
    rows, by = [], {(row["title"], row["fold"]): row for row in trained_models()}
    for key in ((network, fold) for network in ("UNet++", "DeepLabV3+", "PSPNet", OURS) for fold in FOLDS):
        paper = PAPER.get(key, (None, None))
        if kept := by.get(key):
            dice, iou = MeanStd(kept["dice"], kept["dice_std"]), MeanStd(kept["iou"], kept["iou_std"])
            size, images = "{}x{} px".format(*kept["size_px"]), kept["images"]["train"]
            trained = f"{kept['settings']}: {size}, {images} x {kept['epochs']}"
            used = kept["as_used"] and kept["as_used"]["dice"]
            rows.append(TrainedRow(*key, dice, iou, used, kept["ms_per_frame"], trained, *paper))
        else:
            rows.append(TrainedRow(*key, None, None, None, None, None, *paper))
    title = "Table II: networks alone, test objects of each fold, SIMULATED, units of one make; paper: real. "
    title += "ms: frame in to mask out, in the training's run"
    return table_of(title, rows, left=2)


def read_panels(folder: Path) -> Examples:
    """Read the labelled real frames of a folder. Raises `InputError` for a damaged file."""
    numbers = range(1, PANEL_COUNT + 1)
    frames = [read_image(folder / f"{number}_raw.png") for number in numbers]
    read = [read_image(folder / f"{number}_label.png").max(axis=2) for number in numbers]
    labels = [np.where(label > 127, 255, 0).astype(np.uint8) for label in read]
    if any(frame.shape[:2] != label.shape for frame, label in zip(frames, labels, strict=True)):
        raise InputError(f"{folder}: a label and its frame differ in size: copy the folder again")
    return _real_examples(frames, labels, auto_background(frames))


def read_presses(folder: Path) -> Examples:
    """Read photographs of pressed balls with the circles of their contacts. Raises `InputError`."""
    background, pressed = read_circled(folder)
    labels = []
    for image, (x, y, radius) in pressed:
        rows, columns = np.indices(image.shape[:2])
        labels.append(np.where(np.hypot(columns - x, rows - y) <= radius, 255, 0).astype(np.uint8))
    return _real_examples([image for image, _ in pressed], labels, background)


def _real_examples(frames: Sequence[Image], labels: Sequence[Image], background: Image) -> Examples:
    backgrounds = np.stack([background] * len(frames))
    return Examples(np.stack(frames), backgrounds, np.stack(labels), ("",) * len(frames), simulated=False)


def parse_models(texts: Sequence[str], known: Sequence[str]) -> dict[str, Path]:
    models = {}
    for text in texts:
        name, _, file = text.partition("=")
        if name not in known or not file:
            raise InputError(f"--model {text}: give NAME=FILE, NAME being one of {', '.join(known)}")
        if not Path(file).is_file():
            raise InputError(f"--model {text}: file not found: {file}")
        models[name] = Path(file)
    return models


def score_examples(method: str, choice: SegmentChoice, title: str, examples: Examples) -> MethodScore:
    """Segment every frame with its own background. method, title: names of network and frames."""
    found = score_masks(segmenter_maker(choice), examples)
    dice, iou = MeanStd(found.dice, found.dice_std), MeanStd(found.iou, found.iou_std)
    return MethodScore(method, title, len(examples), dice, iou, found.size_ratio)


def measure_times(models: Mapping[str, SegmentChoice], examples: Examples) -> list[MethodTime]:
    """Measure the run time of the methods in turn on the frames of one sensor, with one thread each.

    models: by method. Each method gets several frames in a row, because in use only one method runs, and
    caches that other methods have filled would increase its time.
    """
    background = examples.backgrounds[0]
    pairs = zip(examples.frames, examples.backgrounds, strict=True)
    frames = [frame for frame, its_own in pairs if np.array_equal(its_own, background)]
    segmenters = {name: make_segmenter(choice, background) for name, choice in models.items()}
    networks = {name: load_network(of.model) for name, of in models.items() if of.model != CLASSICAL}
    references = {name: RelativeDifference(background, network.size) for name, network in networks.items()}
    whole_ms: dict[str, list[float]] = {name: [] for name in segmenters}
    alone_ms: dict[str, list[float]] = {name: [] for name in networks}
    for first in range(0, WARM_UP_FRAMES + TIMED_FRAMES, TURN_FRAMES):
        turn = [frames[number % len(frames)] for number in range(first, first + TURN_FRAMES)]
        for name, segmenter in segmenters.items():
            whole_ms[name] += [_cost_ms(segmenter.segment, frame) for frame in turn]
        for name, network in networks.items():
            for frame in turn:
                compare = network.recipe.inputs is NetworkInput.FRAME_AND_DIFFERENCE
                planes = (
                    compared_planes(frame, references[name]) if compare else frame_planes(frame, network.size)
                )
                alone_ms[name].append(_cost_ms(network.logits, planes))
    return [
        MethodTime(
            method=name,
            size_px="{}x{}".format(*networks[name].size) if name in networks else None,
            frame_ms=float(np.median(costs[WARM_UP_FRAMES:])),
            frame_p99_ms=float(np.percentile(costs[WARM_UP_FRAMES:], 99)),
            network_ms=float(np.median(alone_ms[name][WARM_UP_FRAMES:])) if name in networks else None,
        )
        for name, costs in whole_ms.items()
    ]


def _cost_ms(work: Callable[[Any], object], of: Any) -> float:
    began = perf_counter()
    work(of)
    return 1e3 * (perf_counter() - began)


def _mask(segmenter: FrameSegmenter, frame: Image) -> Image:
    mask = segmenter.segment(frame).contact.mask
    return np.zeros(frame.shape[:2], np.uint8) if mask is None else mask


def _limits(scores: Sequence[MethodScore], times: Sequence[MethodTime]) -> list[Measured]:
    by = {(score.method, score.data): score for score in scores}
    time = {row.method: row for row in times}
    ours, real = by[OURS, RANDOMISED], by.get((OURS, REAL))
    share = (time[OURS].network_ms or 0.0) / (time["pspnet"].network_ms or np.inf)
    loss = abs(ours.dice.mean - by["ours-full", RANDOMISED].dice.mean)
    name = "ours, nine real frames: Dice"
    presses = [
        at_least(f"{score.method}, {score.data}: IoU", score.iou.mean, LEAST_PRESS_IOU)
        for score in scores
        if score.method in (OURS, "pspnet") and score.data.startswith(PRESSES)
    ]
    return [
        at_least("ours, SIMULATED objects never trained on: Dice", ours.dice.mean, LEAST_DICE),
        at_least("ours, SIMULATED objects never trained on: IoU", ours.iou.mean, LEAST_IOU),
        at_least("ours, SIMULATED hard lifts: Dice", by[OURS, HARD].dice.mean, LEAST_UNLIKE_DICE),
        informative("ours, frame in to mask out, one thread, ms (median)", time[OURS].frame_ms),
        at_most("ours, the network's run time as a share of PSPNet's", share, MOST_SHARE),
        at_most("eight-bit against full, difference of Dice", loss, MOST_LOSS),
        not_there(name) if real is None else at_least(name, real.dice.mean, LEAST_UNLIKE_DICE),
        *presses,
    ]


def _threads_agree(model: str, examples: Examples) -> Measured:
    """Count the pixels in which masks made with one and with two threads differ."""
    differing = 0
    makers = [segmenter_maker(SegmentChoice(model, threads=count)) for count in (1, 2)]
    for frame, background in list(zip(examples.frames, examples.backgrounds, strict=True))[:THREADED_FRAMES]:
        one, two = (_mask(make(background), frame) for make in makers)
        differing += int(np.count_nonzero(one != two))
    return at_most(f"ours, pixels in which 1 and 2 threads differ, {THREADED_FRAMES} frames", differing, 0)


STUDY = Study("segmentation", SegmentationOptions, measure, "methods", ("out", "seed"))
