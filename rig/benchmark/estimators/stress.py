"""Score every estimator on SIMULATED clips with known angles, under one disturbance at a time.

Disturbances change the images as noise, blur, codecs, light and lost frames do; they are functions of a clip
and a random generator.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.images import decode_stored, encode_jpeg
from drivers.types import Frame, Image
from fakes.studio.clips import ROLLER, ROLLER_TURN_DEG, TWO_BALLS, Clip, Scene, opposite, render_clip
from rig.benchmark.estimators.contenders import ContenderScore, make_unfiltered, score_all
from rig.experiments.lift_plan import derived_seed
from rig.frames.estimates import estimate_frames
from rig.results.scores import SeriesScore, score_series
from rig.tactile.sample import SlipSample

Disturbance = Callable[[Clip, np.random.Generator], Clip]
CONTACTS = ("t1:1", "t3:2", "5:1", "t5:2")
ROUND_CONTACTS = tuple(f"{name}:{site}" for name in ("3", "16", "12") for site in (0, 1))
"""Smooth balls and a dome, of the objects 3, 12 and 16, whose rotation is unobservable."""
NAMES = ("slip", "ecc", "skeleton", "ellipse", "pca")
LED_PATTERN = (1.0, -1.0, 0.5)  # relative error of red, green and blue for a fault of the LEDs
GAP_S = 0.25  # length of the gap in the stream


def noise(sigma_grey: float) -> Disturbance:
    """Add white noise to every frame: one larger field, shifted at random, because that is much faster."""

    def noisy(clip: Clip, rng: np.random.Generator) -> Clip:
        height, width = clip.background.shape[:2]
        field = rng.normal(0.0, sigma_grey, (height + 64, width + 64, 3)).astype(np.float32)

        def disturb(image: Image) -> Image:
            down, across = rng.integers(0, 64, 2)
            return _grey(image + field[down : down + height, across : across + width])

        return replace(clip, frames=tuple(map(disturb, clip.frames)))

    return noisy


def blur(sigma_px: float) -> Disturbance:
    return _each(lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8))


def jpeg(quality: int) -> Disturbance:
    """Encode and decode every frame as JPEG; the background is unchanged."""
    return _each(lambda image: decode_stored(encode_jpeg(image, quality)), background=False)


def resize(width: int, height: int) -> Disturbance:
    def change(image: Image) -> Image:
        way = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(image, (width, height), interpolation=way), np.uint8)

    return _each(change)


def landscape(clip: Clip, rng: np.random.Generator) -> Clip:
    lying = _each(lambda image: np.ascontiguousarray(np.rot90(image)))(clip, rng)
    return replace(lying, aspect=None if clip.aspect is None else 1.0 / clip.aspect)


def drift(
    error: float, pattern: Sequence[float] = LED_PATTERN, first: float = 0.0, grey: float = 0.0
) -> Disturbance:
    """Scale the channels of all frames, but not of the background, and add a constant, as stray light does.

    The gains drift over the clip to 1 + error * pattern. first: fraction of the error at the first frame.
    """

    def relight(clip: Clip, rng: np.random.Generator) -> Clip:
        gains = [error * s * np.asarray(pattern, float) for s in np.linspace(first, 1.0, len(clip.frames))]
        frames = (
            _grey(frame * (1.0 + gain).astype(np.float32) + np.float32(grey))
            for gain, frame in zip(gains, clip.frames, strict=True)
        )
        return replace(clip, frames=tuple(frames))

    return relight


def drop_frames(clip: Clip, rng: np.random.Generator) -> Clip:
    return _in_order(clip, np.flatnonzero(rng.random(len(clip.frames)) < 0.5))


def gap(clip: Clip, rng: np.random.Generator) -> Clip:
    """Drop the frames of a quarter of a second during the rotation."""
    times, begins = np.array(clip.time_ns), clip.moves_ns + to_ns(0.2)
    return _in_order(clip, np.flatnonzero((times < begins) | (times >= begins + to_ns(GAP_S))))


def every(step: int) -> Disturbance:
    return lambda clip, rng: _in_order(clip, np.arange(0, len(clip.frames), step))


def duplicate_frames(clip: Clip, rng: np.random.Generator) -> Clip:
    """Replace every third frame by a copy of the previous frame, at its own time."""
    frames, truth = list(clip.frames), clip.angle_deg.copy()
    for i in range(2, len(frames), 3):
        frames[i], truth[i] = frames[i - 1], truth[i - 1]
    return replace(clip, frames=tuple(frames), angle_deg=truth)


def tear_frames(clip: Clip, rng: np.random.Generator) -> Clip:
    """Replace the lower part of every tenth frame by that of the frame three frames earlier."""
    frames = list(clip.frames)
    for i in range(5, len(frames), 10):
        cut = int(rng.integers(frames[i].shape[0] // 4, 3 * frames[i].shape[0] // 4))
        frames[i] = np.concatenate([clip.frames[i][:cut], clip.frames[i - 3][cut:]])
    return replace(clip, frames=tuple(frames))


def late(clip: Clip, rng: np.random.Generator) -> Clip:
    order = np.arange(len(clip.frames))
    for i in range(5, len(order) - 1, 10):
        order[i], order[i + 1] = order[i + 1], order[i]
    return _in_order(clip, order)


def _each(change: Callable[[Image], Image], background: bool = True) -> Disturbance:
    """Return a disturbance that changes every frame, and the background if `background`."""
    return lambda clip, rng: replace(
        clip,
        background=change(clip.background) if background else clip.background,
        frames=tuple(change(frame) for frame in clip.frames),
    )


def _grey(values: NDArray[np.float32]) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _in_order(clip: Clip, order: NDArray[np.intp]) -> Clip:
    return replace(
        clip,
        frames=tuple(clip.frames[i] for i in order),
        time_ns=tuple(clip.time_ns[i] for i in order),
        angle_deg=clip.angle_deg[order],
    )


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition: changes to the standard scene, and a disturbance of its images."""

    name: str
    change: Disturbance = lambda clip, rng: clip
    scene: Mapping[str, Any] = field(default_factory=dict)
    contacts: tuple[str, ...] = CONTACTS  # used instead of the standard contacts
    refused: bool = False  # whether frames should be refused
    both_signs: bool = False  # also with the opposite rotation
    group: str = ""


def _group(name: str, *conditions: Condition) -> Iterator[Condition]:
    return (replace(condition, group=name) for condition in conditions)


CONDITIONS = (
    *_group(
        "image",
        Condition("undisturbed", both_signs=True),
        *(Condition(f"noise {s} grey", noise(s)) for s in (4, 8)),
        *(Condition(f"blur {s} px", blur(s)) for s in (2, 4)),
        *(Condition(f"JPEG quality {q}", jpeg(q)) for q in (80, 50, 20)),
    ),
    *_group(
        "light",
        Condition("LEDs 15 % off since the background", drift(0.15, first=1.0)),
        Condition("LEDs 30 % off since the background", drift(0.30, first=1.0)),
        Condition("LEDs drift by 15 %", drift(0.15)),
        Condition("LEDs drift by 30 %", drift(0.30)),
        Condition("brightness drifts by -20 %", drift(-0.2, (1, 1, 1))),
        Condition("white balance drifts by 10 %", drift(0.1, (1.0, 0.0, -1.0))),
        Condition("10 grey of stray light", drift(0.0, grey=10.0)),
    ),
    *_group(
        "stream",
        Condition("half the frames dropped", drop_frames),
        Condition("0.25 s gap in the turn", gap),
        Condition("every third frame a duplicate", duplicate_frames),
        Condition("every tenth frame torn", tear_frames),
        Condition("every tenth frame late", late),
        Condition("30 fps", every(2)),
    ),
    *_group(
        "motion",
        Condition("80 deg/s", scene={"rate_deg_s": 80.0}),
        Condition("120 deg/s", scene={"rate_deg_s": 120.0}),
        Condition("120 deg/s at 30 fps", scene={"rate_deg_s": 120.0, "rate_hz": 30.0}),
        *(
            Condition(f"turn by {a:+d} deg", scene={"angle_deg": float(a), "rate_deg_s": 60.0})
            for a in (60, 90, -90)
        ),
    ),
    *_group(
        "contact",
        Condition("gel torsion 1.5 deg", scene={"lag_deg": 1.5}),
        Condition("gel torsion 3 deg", scene={"lag_deg": 3.0}),
        Condition("force grows by 50 %", scene={"pressed": 0.5}),
        Condition("clipped by the border", scene={"center_mm": (5.0, 6.0)}),
        Condition("several contacts", contacts=("11:0", "14:0", TWO_BALLS), both_signs=True),
        Condition(
            "ribbed roller: ribs turn by 4, outline by 13.5 deg",
            scene={"angle_deg": ROLLER_TURN_DEG, "rate_deg_s": 4.0},
            contacts=(ROLLER,),
            both_signs=True,
        ),
        Condition("pixels' aspect not known", lambda clip, rng: replace(clip, aspect=None)),
        Condition("other sensor unit", scene={"unit": 5}),
    ),
    *_group(
        "size",
        *(Condition(f"{w} x {h} px", resize(w, h)) for w, h in ((60, 80), (120, 160), (480, 640))),
        Condition("320 x 240 px, lying", landscape),
    ),
    *_group(
        "round",
        Condition("smooth round contacts", contacts=ROUND_CONTACTS, refused=True),
        Condition(
            "smooth round contacts, other unit", scene={"unit": 5}, contacts=ROUND_CONTACTS, refused=True
        ),
    ),
)


StressedClip = tuple[str, str, SeriesScore]  # condition, estimator, and the score on one clip


@dataclass(frozen=True, slots=True)
class StressRow:
    group: str
    condition: str
    estimator: str
    refused: bool
    clips: int
    score: ContenderScore


def stress_tasks() -> list[tuple[str, str]]:
    """Return the pieces of work: group of conditions, and contact."""
    return list(dict.fromkeys((c.group, contact) for c in CONDITIONS for contact in c.contacts))


def run_stress(seed: int, names: Sequence[str], task: tuple[str, str]) -> list[StressedClip]:
    """Score every estimator on the clips of a task, in a worker process."""
    cv2.setNumThreads(1)
    group, contact = task
    scores = []
    for condition in (c for c in CONDITIONS if c.group == group and contact in c.contacts):
        scene = Scene(contact, seed=seed, **condition.scene)
        for shown in (scene, opposite(scene)) if condition.both_signs else (scene,):
            rng = np.random.default_rng(derived_seed(seed, condition.name, contact))
            clip = condition.change(render_clip(shown), rng)
            key = f"{contact.partition(':')[0]}/{contact} {shown.angle_deg:+.0f} deg"
            frames = [Frame(*of, 0, "") for of in zip(clip.frames, clip.time_ns, strict=True)]
            for name in names:
                estimator = make_unfiltered(clip.background, clip.aspect, (name,))[name]
                samples = list(estimate_frames(estimator, frames))
                scores.append((condition.name, name, _series_score(key, samples, clip)))
    return scores


def _series_score(key: str, samples: Sequence[SlipSample], clip: Clip) -> SeriesScore:
    """Score from the start of the rotation on, relative to the mean angle of the last 10 frames before it.

    Samples are compared at the time of their frame; a late or repeated frame has no angle.
    """
    still = [
        s.angle_deg
        for s, t in zip(samples, clip.time_ns, strict=True)
        if t < clip.moves_ns and s.angle_deg is not None
    ]
    zero = float(np.mean(still[-10:])) if still else None
    moving = [i for i, t in enumerate(clip.time_ns) if t >= clip.moves_ns]
    answers = [samples[i].angle_deg for i in moving]
    return score_series(
        key,
        [None if a is None or zero is None else a - zero for a in answers],
        [samples[i].sigma_deg for i in moving],
        [float(clip.angle_deg[i]) for i in moving],
    )


def stress_rows(scores: Sequence[StressedClip]) -> list[StressRow]:
    rows, names = [], dict.fromkeys(name for _, name, _ in scores)
    for c in CONDITIONS:
        for name in names:
            of = [score for condition, estimator, score in scores if (condition, estimator) == (c.name, name)]
            if of:
                rows.append(StressRow(c.group, c.name, name, c.refused, len(of), score_all(of)))
    return rows
