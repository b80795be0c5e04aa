"""`rig benchmark slip`: time, accuracy and size of `slip` beside their limits."""

import ast
import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.children import python_command
from drivers.errors import InputError, RigError
from drivers.types import Image
from rig.benchmark.clips.labelled import ClipVersion, clip_version, read_clips
from rig.benchmark.clips.public import PACKAGED
from rig.benchmark.clips.study import JudgedLabel, run_clip, score
from rig.benchmark.estimators.contenders import score_all
from rig.benchmark.harness import Report, Run, Study, limit_table, processor_and_cores
from rig.benchmark.measured import Measured, at_least, at_most, between, informative
from rig.benchmark.renderer import LIFTS_PER_SEED, answer_lift
from rig.benchmark.seeds import LiftCase, SeedLift, lift_cases, recorded_lift, scored_lift
from rig.benchmark.slip import contender
from rig.config import BenchConfig, load_bench
from rig.declared import option
from rig.experiments.trial import resolve_objects
from rig.frames.estimates import Estimate, TimedImage, frame_ms
from rig.frames.of_session import recording_frames
from rig.tactile.contact.dots import is_dotted
from rig.tactile.estimators import EstimatorChoice, choose_estimator

OWN = Path(__file__).resolve().parents[3]  # folder of this version
ROUNDS = 2
"""Each frame is timed this often, and its shortest time counts: other programs can only lengthen it."""
FRAMES = 600  # largest number of frames per file, 10 s of a lift, as in `rig benchmark estimators`
STREAMS, STREAM_HZ = 2, 60.0  # fingertips of the rig, and the rate of a DIGIT
CLIPS, LIFTS, CONTACT_MS = "clips", "SIMULATED lifts", "ms per frame with contact"
MOST_MS, MOST_OF_OTHER = {CLIPS: (2.0, 4.5), LIFTS: (0.7, 3.0)}, (0.28, 0.25)
"""Limits of median and 99 % of the time per frame with contact; for clips, also as fractions of the times of
another version."""
NO_DOTS, DOTS = "turns without printed dots", "turns with printed dots"
LABELS = {"development": (0.90, 0.90), "validation": (0.85, 0.88), NO_DOTS: (0.95, 0.90), DOTS: (0.95, 0.95)}
"""Limits of the shares of labels that are within 3 degrees or 2 label sigmas, and useful, by group."""
TWO_SIGMA, MOST_WRONG = (0.92, 0.98), 0.01  # limits of further shares of labels of the first two groups
SEEDS, DRAWN = (0, 32), "SIMULATED by the second renderer"  # seeds of the second renderer
MOST_MARE_DEG, MOST_WORST_DEG, MOST_RATE_DEG_S = 0.45, 4.0, 200.0
ASKED = {
    "fake": "0.27 over 45 lifts: rig benchmark seeds --seeds 1",
    "hard": "1.2, worst 8, wrong 1 over 90 lifts: rig benchmark seeds --bench hard",
}
"""Limits of complete sets, by bench."""
MOST_LINES, MOST_CONSTANTS = 2600, 60


def store(
    file: Path, background: Image, frames: Iterable[TimedImage], aspect: float | None = None, sign: int = 1
) -> None:
    shown = [(of.time_ns, of.image) for of in islice(frames, FRAMES) if of.image is not None]
    times_ns, images = zip(*shown, strict=True)
    sensor = {"background": background, "aspect": aspect or 0.0, "sign": sign}
    np.savez(file, images=np.stack(images), times_ns=np.array(times_ns, np.int64), **sensor)


class Contender:
    """The process of an estimator of one version. folder: contains the version's package `rig`.

    name: the estimator, and the folder of another version. Raises `InputError` if there is no version in the
    folder, and `RigError` if the process ends.
    """

    def __init__(self, estimator: str, folder: Path) -> None:
        folder = folder.resolve()
        self.name = estimator if folder == OWN else f"{estimator} in {folder.name}"
        self.other_version, self._estimator = folder != OWN, estimator
        if not (folder / "rig" / "tactile" / "estimators.py").is_file():
            raise InputError(f"{folder}: holds no slip rig: give the folder with its package 'rig'")
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(  # noqa: S603, this Python with a file of this package
            python_command(contender.__file__),
            env={**os.environ, **threads, "PYTHONPATH": str(folder)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for this process, which then ends that one
        )
        if (found := Path(self._answer())) != folder:
            self.close()
            raise RigError(f"{folder}: Python imports the slip rig in {found} instead")

    def ask(self, job: str, *arguments: Any) -> Any:
        """Return the answer of a function of `contender`. Raises `RigError` if the process has ended."""
        with suppress(BrokenPipeError):  # the answer is then missing
            print(json.dumps([job, self._estimator, *arguments]), file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> Any:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            self.close()
            raise RigError(f"{self.name}: the process of this estimator has ended; its message is above")
        return json.loads(line)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def contact_ms(
    of: Sequence[Contender],
    files: Sequence[Path],
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> list[list[float]]:
    """Return each contender's CPU times of the frames with contact, by its own detection, in ms.

    The contenders run in turn on each file, in an order that rotates. progress: see `Run`.
    """
    spent: list[list[float]] = [[] for _ in of]
    for number, file in enumerate(files):
        rounds: list[list[list[float | None]]] = [[] for _ in of]
        for turn in range(number, number + ROUNDS * len(of)):
            place = turn % len(of)
            rounds[place].append(of[place].ask("contact_times", str(file)))
        for times_ms, runs in zip(spent, rounds, strict=True):
            times_ms += [min(ms) for frame in zip(*runs, strict=True) if (ms := [m for m in frame if m])]
        progress(number + 1, len(files), f"time on {file.stem}")
    return spent


@dataclass(frozen=True, slots=True)
class SlipOptions:
    clips: Path | None = option(None, "Labelled clips at the rate of a sensor in use: the set octopi.")
    turns: list[Path] | None = option(None, "Further labelled clips; repeat for more.")
    groups: Path = option(
        PACKAGED / "octopi.csv", "CSV file with columns clip,group, for --clips.", show_default="of octopi"
    )
    estimator: list[str] | None = option(
        None, "Repeat for more, whose times are measured beside those of the first. Default: slip."
    )
    against: list[Path] | None = option(
        None, "Another version of the slip rig, to measure its times beside; repeat for more."
    )
    lifts: int = option(1, "Lifts of each of the trial's nine objects on each bench.", min=0, max=5)
    drawn: int = option(32, "Lifts of the second renderer per seed.", min=0, max=1000)
    limits: bool = option(False, "Exit with code 4 if a limit is missed.", "--limits")


def measure(options: SlipOptions, run: Run) -> Report:
    """Print time, accuracy and size of slip beside their limits, in 10 minutes on two idle cores.

    Give the clips that `rig benchmark clips CLONE --set NAME` makes: of octopi with --clips, of digit-edges
    and gripper-slips with --turns. Figures whose data are not given are skipped.

    Times are CPU times of the frames with contact, through `rig.estimator` with its checks, on one core,
    before the other figures are measured. With --against, another version of this program gets the same
    frames in turn with this one, in another process.
    For the figure of two streams, clips are shown in real time at 60 frames per second each, faster than they
    were recorded, on one core and with real-time priority. A frame is dropped if it still waits when the next
    one of its stream arrives.

    All other figures are of the first estimator, and use all cores: --clips in four versions each, --turns as
    they are, and SIMULATED lifts. The frames take 2 GB in the folder for temporary files.

    Examples:
      rig benchmark slip --clips clips --turns digit --turns dots
      rig benchmark slip --clips clips --against ../before --lifts 0 --drawn 0
      rig benchmark slip --clips clips --turns digit --limits --readme docs/measurements.md
    """
    names = options.estimator or ["slip"]
    choice, *_ = [choose_estimator(name) for name in names]
    versions = [(name, OWN) for name in names] + [(names[0], folder) for folder in options.against or ()]
    for folder in [of for of in (options.clips, *(options.turns or ())) if of is not None]:
        read_clips(folder)  # an invalid set is an error before the lifts, which take minutes
    with tempfile.TemporaryDirectory(prefix="rig_slip_") as place, ExitStack() as stack:
        processes = [stack.enter_context(closing(Contender(*of))) for of in versions]
        easy = _lifts("fake", options.lifts, choice, run, Path(place))
        rows = [*_times(options, processes, Path(place), run)]
    rows += _labels(options, choice, run)
    hard = _lifts("hard", options.lifts, choice, run)
    rows += [*_drawn(options.drawn, choice, run), *_sample("fake", easy), *_sample("hard", hard)]
    rows += size_rows(OWN / "rig" / "tactile" / "slip", OWN / "rig" / "models" / "slip.json")
    table = limit_table(rows, f"'{names[0]}'").markdown()
    section = f"{processor_and_cores()}.\n\n{table}"
    return Report((), rows, f"'{names[0]}'", section=section, binding=options.limits)


def _skipped(name: str, source: str) -> Measured:
    return Measured(name, None, f"no data: see {source}", None)


def _times(options: SlipOptions, of: Sequence[Contender], folder: Path, run: Run) -> Iterator[Measured]:
    """Yield the times of all estimators on clips and on the lifts stored in a folder, and dropped frames."""
    lifts, clips = sorted(folder.glob("*.npz")), []
    for clip in read_clips(options.clips) if options.clips else ():
        clips.append(folder / f"{clip.name}.npz")
        store(clips[-1], clip.background, clip.series.read())
    for kind, files, source in ((CLIPS, clips, "--clips"), (LIFTS, lifts, "--lifts")):
        rows = _time_rows(kind, of, contact_ms(of, files, run.progress))
        yield from rows if files else [_skipped(f"{kind}, {CONTACT_MS}", source)]
    streams = [[str(file) for file in clips[place::STREAMS] or clips] for place in range(STREAMS)]
    for each in of if clips else ():
        frames, dropped, delay_ms = each.ask("stream", streams, STREAM_HZ)
        name = f"{STREAMS} streams of clips, one core, {each.name}"
        row = f"{name}, dropped of {frames} frames", dropped
        yield at_most(*row, 0) if each is of[0] else informative(*row)
        yield informative(f"{name}, longest time from frame to angle, ms", delay_ms)


def _time_rows(kind: str, of: Sequence[Contender], times_ms: Sequence[list[float]]) -> Iterator[Measured]:
    compared = kind == CLIPS and any(each.other_version for each in of)
    for place, percentile in enumerate(("median", "99 %")):
        found = [ms and ms[2 * place] for ms in map(frame_ms, times_ms)]
        for each, ms in zip(of, found, strict=True):
            row = f"{kind}, {CONTACT_MS}, {percentile}, {each.name}", ms
            limited = each is of[0] and not compared
            yield at_most(*row, MOST_MS[kind][place]) if limited else Measured(*row, "", None)
            if compared and each.other_version:
                name = f"{kind}, {percentile} of {of[0].name} as a fraction of that of {each.name}"
                yield at_most(name, found[0] and ms and found[0] / ms, MOST_OF_OTHER[place])


def _labels(options: SlipOptions, choice: EstimatorChoice, run: Run) -> Iterator[Measured]:
    cases = [(options.clips, options.groups, version) for version in ClipVersion if options.clips]
    cases += [(folder, None, ClipVersion.PLAIN) for folder in options.turns or ()]
    answers = run.each(partial(_answers, choice), cases, lambda case: ", ".join(map(str, case)))
    found = [clip for clips in answers for clip in clips]
    for group, (within, useful) in LABELS.items():
        labels = [label for name, of, _ in found if name == group for label in of]
        if not labels:
            yield _skipped(f"labels, {group}", "--turns" if group in (DOTS, NO_DOTS) else "--clips")
            continue
        of, name = score(labels, (), True), f"{len(labels)} labels, {group}"
        yield at_least(f"{name}, within 3 degrees or 2 label sigmas", of.within, within)
        yield at_least(f"{name}, useful", of.useful, useful)
        if group not in (DOTS, NO_DOTS):
            yield between(f"{name}, within two sigma", of.two_sigma, *TWO_SIGMA)
            yield at_most(f"{name}, confidently wrong", of.confidently_wrong, MOST_WRONG)
    name, changes = "largest change between two frames of clips, degrees per second", [of for *_, of in found]
    yield at_most(name, max(changes), MOST_RATE_DEG_S) if changes else _skipped(name, "--clips")


def _answers(
    choice: EstimatorChoice, case: tuple[Path, Path | None, ClipVersion]
) -> list[tuple[str, tuple[JudgedLabel, ...], float]]:
    """Return group, labels and largest change of each clip in a version. Runs in a worker process.

    case: folder, file of groups, and version. Without a file, the clips are grouped by their gels.
    """
    cv2.setNumThreads(1)
    folder, groups, version = case
    found = []
    for clip in read_clips(folder, groups):
        of = run_clip(clip_version(clip, version), choice)
        group = clip.group if groups else DOTS if is_dotted(clip.background) else NO_DOTS
        found.append((group, of.labels, largest_change_deg_s(of.estimate)))
    return found


def largest_change_deg_s(estimate: Estimate) -> float:
    """Return the largest change of the angle between successive frames, per time between them."""
    angles = estimate.angles
    changes = np.abs(np.diff(angles.angle_deg)) / np.diff(angles.time_s)
    return round(float(np.nanmax(changes, initial=0.0)), 1)


def _lifts(
    bench: str, lifts: int, choice: EstimatorChoice, run: Run, keep: Path | None = None
) -> list[SeedLift]:
    """Carry out and score lifts of the trial's objects. keep: folder for the frames of one fingertip."""
    config = load_bench(bench)
    cases = lift_cases(bench, [run.seed], resolve_objects([], config.objects), lifts)
    cases.sort(key=attrgetter("lift"))
    return run.each(partial(_lift, config, choice, keep), cases)


def _lift(config: BenchConfig, choice: EstimatorChoice, keep: Path | None, case: LiftCase) -> SeedLift:
    with recorded_lift(config, case, choice) as (recording, row):
        if keep is not None:
            tip = recording_frames(recording)[case.lift % 2]
            file = keep / f"{case.object_id}_{case.lift}.npz"
            store(file, tip.background, tip.frames.read(), tip.aspect, tip.sign)
        return scored_lift(recording, case.seed, row)


def _sample(bench: str, lifts: Sequence[SeedLift]) -> Iterator[Measured]:
    """Yield figures of a sample of lifts, which have no limits; those of the complete set are named."""
    of, name = score_all([lift.score for lift in lifts]), f"SIMULATED, {len(lifts)} lifts on bench {bench}"
    asked = ASKED[bench] if lifts else "no data: see --lifts"
    yield Measured(f"{name}, MARE, degrees", of.mare and of.mare.mean_deg, asked, None)
    if lifts:
        yield Measured(f"{name}, worst lift, degrees", of.worst_deg, "", None)
        yield informative(f"{name}, lifts confidently wrong", of.wrong_lifts)


def _drawn(lifts: int, choice: EstimatorChoice, run: Run) -> Iterator[Measured]:
    numbers = [LIFTS_PER_SEED * seed + number for seed in SEEDS for number in range(lifts)]
    answers = run.each(partial(answer_lift, [choice]), numbers, "second renderer, lift {}".format)
    drawn = [of[choice.name].score for of in answers]
    for place, seed in enumerate(SEEDS if lifts else ()):
        mare = score_all(drawn[place * lifts : (place + 1) * lifts]).mare
        name = f"{DRAWN}, {lifts} lifts of seed {seed}, MARE, degrees"
        yield at_most(name, mare and mare.mean_deg, MOST_MARE_DEG)
    name, worst_deg = f"{DRAWN}, worst lift, degrees", score_all(drawn).worst_deg
    yield at_most(name, worst_deg, MOST_WORST_DEG) if lifts else _skipped(name, "--drawn")


def size_rows(package: Path, fitted: Path) -> Iterator[Measured]:
    """Yield the numbers of lines and of names that modules bind to numbers, and of fitted parameters."""
    modules = [module.read_text(encoding="utf-8") for module in package.glob("*.py")]
    bound = [each for module in modules for each in ast.parse(module).body if isinstance(each, ast.Assign)]
    constants = 0
    for each in bound:  # the names of an assignment count if its value contains a number
        values = [of.value for of in ast.walk(each.value) if isinstance(of, ast.Constant)]
        names = [of for target in each.targets for of in ast.walk(target) if isinstance(of, ast.Name)]
        constants += len(names) if any(type(value) in (int, float) for value in values) else 0
    parameters = sum(map(len, json.loads(fitted.read_text(encoding="utf-8"))["parameters"].values()))
    yield at_most(f"lines of {package.name}", sum(len(of.splitlines()) for of in modules), MOST_LINES)
    name = f"constants ({constants}) and parameters ({parameters}) of {package.name}"
    yield at_most(name, constants + parameters, MOST_CONSTANTS)


STUDY = Study("slip", SlipOptions, measure, "cases", ("out", "readme", "jobs", "seed"), simulated=False)
