"""Score every estimator on SIMULATED clips with known angles, under one disturbance at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import cv2
import numpy as np

from drivers.types import Frame
from fakes.studio.clips import ROLLER, ROLLER_TURN_DEG, TWO_BALLS, Clip, Scene, opposite, render_clip
from rig.benchmark.estimators import disturbances as d
from rig.benchmark.estimators.contenders import unfiltered
from rig.benchmark.estimators.scores import ContenderScore, score_all
from rig.experiments.grasp_plans import derived_seed
from rig.frames.estimates import estimate_frames
from rig.results.scores import SeriesScore, score_series
from rig.tactile.sample import SlipSample

CONTACTS = ("t1:1", "t3:2", "5:1", "t5:2")
ROUND_CONTACTS = tuple(f"{name}:{site}" for name in ("3", "16", "12") for site in (0, 1))
"""Smooth balls and a dome, of the objects 3, 12 and 16, whose rotation is unobservable."""
NAMES = ("slip", "ecc", "skeleton", "ellipse", "pca")


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition: changes to the standard scene, and a disturbance of its images.

    contacts: used instead of the standard contacts. refused: whether frames should be refused. both_signs:
    also with the opposite rotation.
    """

    group: str
    name: str
    change: d.Disturbance = d.nothing
    scene: Mapping[str, Any] = field(default_factory=dict)
    contacts: tuple[str, ...] = CONTACTS
    refused: bool = False
    both_signs: bool = False


@dataclass(frozen=True, slots=True)
class StressTask:
    """A task of one worker: all conditions of a group, for one contact and seed."""

    group: str
    contact: str
    seed: int
    names: tuple[str, ...] = NAMES

    def __str__(self) -> str:
        return f"stress: {self.group}, {self.contact}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class StressedClip:
    """Score of one estimator on one clip under one condition."""

    condition: str
    estimator: str
    score: SeriesScore


@dataclass(frozen=True, slots=True)
class StressRow:
    """Score of one estimator on all clips under one condition."""

    group: str
    condition: str
    estimator: str
    refused: bool
    clips: int
    score: ContenderScore


def stress_tasks(seed: int, names: tuple[str, ...] = NAMES) -> list[StressTask]:
    """Return the pieces of work, the same for the same seed. names: of the estimators."""
    work = dict.fromkeys((c.group, contact) for c in CONDITIONS for contact in c.contacts)
    return [StressTask(group, contact, seed, names) for group, contact in work]


def run_stress(task: StressTask) -> list[StressedClip]:
    """Score every estimator on the clips of a task, in a worker process."""
    cv2.setNumThreads(1)
    scores = []
    for condition in CONDITIONS:
        if condition.group != task.group or task.contact not in condition.contacts:
            continue
        scene = Scene(task.contact, seed=task.seed, **condition.scene)
        for shown in (scene, opposite(scene)) if condition.both_signs else (scene,):
            rng = np.random.default_rng(derived_seed(task.seed, condition.name, task.contact))
            clip = condition.change(render_clip(shown), rng)
            scores += [_scored(condition, task, shown, name, clip) for name in task.names]
    return scores


def stress_rows(scores: Sequence[StressedClip]) -> list[StressRow]:
    """Combine clips by condition, in the order of the table."""
    rows, names = [], dict.fromkeys(score.estimator for score in scores)
    for condition in CONDITIONS:
        for name in names:
            of = [s for s in scores if s.condition == condition.name and s.estimator == name]
            if of:
                score = score_all([s.score for s in of])
                rows.append(
                    StressRow(condition.group, condition.name, name, condition.refused, len(of), score)
                )
    return rows


def _scored(condition: Condition, task: StressTask, scene: Scene, name: str, clip: Clip) -> StressedClip:
    estimator = unfiltered(clip.background, clip.aspect, (name,))[name]
    shown = [Frame(*of, 0, "") for of in zip(clip.frames, clip.time_ns, strict=True)]
    samples = [of.sample for of in estimate_frames(estimator, shown)]
    key = f"{task.contact.partition(':')[0]}/{task.contact} {scene.angle_deg:+.0f} deg"
    return StressedClip(condition.name, name, _series_score(key, samples, clip))


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


def _light() -> list[Condition]:
    group, white = "light", (1.0, 0.0, -1.0)
    return [
        Condition(group, "LEDs 15 % off since the background", d.gains(0.15)),
        Condition(group, "LEDs 30 % off since the background", d.gains(0.30)),
        Condition(group, "LEDs drift by 15 %", d.drift(0.15)),
        Condition(group, "LEDs drift by 30 %", d.drift(0.30)),
        Condition(group, "brightness drifts by -20 %", d.drift(-0.2, (1, 1, 1))),
        Condition(group, "white balance drifts by 10 %", d.drift(0.1, white)),
        Condition(group, "10 grey of stray light", d.offset(10.0)),
    ]


def _image() -> list[Condition]:
    return [
        Condition("image", "undisturbed", both_signs=True),
        *(Condition("image", f"noise {s} grey", d.noise(s)) for s in (4, 8)),
        *(Condition("image", f"blur {s} px", d.blur(s)) for s in (2, 4)),
        *(Condition("image", f"JPEG quality {q}", d.jpeg(q)) for q in (80, 50, 20)),
    ]


def _stream() -> list[Condition]:
    group = "stream"
    return [
        Condition(group, "half the frames dropped", d.dropped),
        Condition(group, "0.25 s gap in the turn", d.gap),
        Condition(group, "every third frame a duplicate", d.duplicated),
        Condition(group, "every tenth frame torn", d.torn),
        Condition(group, "every tenth frame late", d.late),
        Condition(group, "30 fps", d.every(2)),
    ]


def _motion() -> list[Condition]:
    fast = {"rate_deg_s": 120.0}
    return [
        Condition("motion", "80 deg/s", scene={"rate_deg_s": 80.0}),
        Condition("motion", "120 deg/s", scene=fast),
        Condition("motion", "120 deg/s at 30 fps", scene={**fast, "rate_hz": 30.0}),
        *(
            Condition("motion", f"turn by {a:+d} deg", scene={"angle_deg": float(a), "rate_deg_s": 60.0})
            for a in (60, 90, -90)
        ),
    ]


def _contact() -> list[Condition]:
    group = "contact"
    several = ("11:0", "14:0", TWO_BALLS)
    return [
        Condition(group, "gel torsion 1.5 deg", scene={"lag_deg": 1.5}),
        Condition(group, "gel torsion 3 deg", scene={"lag_deg": 3.0}),
        Condition(group, "force grows by 50 %", scene={"pressed": 0.5}),
        Condition(group, "clipped by the border", scene={"center_mm": (5.0, 6.0)}),
        Condition(group, "several contacts", contacts=several, both_signs=True),
        Condition(
            group,
            "ribbed roller: ribs turn by 4, outline by 13.5 deg",
            scene={"angle_deg": ROLLER_TURN_DEG, "rate_deg_s": 4.0},
            contacts=(ROLLER,),
            both_signs=True,
        ),
        Condition(group, "pixels' aspect not known", d.uncalibrated),
        Condition(group, "other sensor unit", scene={"unit": 5}),
    ]


def _size() -> list[Condition]:
    sizes = ((60, 80), (120, 160), (480, 640))
    return [
        *(Condition("size", f"{w} x {h} px", d.resized(w, h)) for w, h in sizes),
        Condition("size", "320 x 240 px, lying", d.landscape),
    ]


def _round() -> list[Condition]:
    refused = partial(Condition, "round", contacts=ROUND_CONTACTS, refused=True)
    return [
        refused("smooth round contacts"),
        refused("smooth round contacts, other unit", scene={"unit": 5}),
    ]


CONDITIONS = (*_image(), *_light(), *_stream(), *_motion(), *_contact(), *_size(), *_round())
