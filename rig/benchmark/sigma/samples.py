"""Answers of the estimator slip with known errors, and the terms of their variance."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np

from rig.benchmark.clips.labelled import LabelledClip
from rig.benchmark.renderer.lifts import BACKGROUND_FRAMES, LIFT_NS, SIGNS, draw_course, frames
from rig.frames.estimates import TimedImage
from rig.tactile.contact.background import mean_background
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.fused_angle import Fused, coefficients

LIFT_STRIDE = 15
"""Every 15th frame of a lift is a sample, because the errors of neighbouring frames are correlated."""


@dataclass(frozen=True, slots=True)
class KnownError:
    """The error of one answer and the terms of its variance, in degrees and squared degrees.

    label_deg: sigma of the ground truth. known: the part of the variance that is not fitted. terms: terms of
    the fitted part, in the order of `rig.tactile.slip.fused_angle.TERMS`, times the weight of the joint
    tracker.
    """

    error_deg: float
    label_deg: float
    known: float
    terms: tuple[float, ...]


def clip_errors(clip: LabelledClip) -> list[KnownError]:
    """Return the errors at the labels of a clip."""
    answers = _answers(SlipEstimator(clip.background), clip.series.read())
    zero = _first_from(answers, clip.reference_frame)
    labelled = ((label, answers[label.frame]) for label in clip.labels)
    return [
        _known_error(fused, fused.angle_rad - zero, label.angle_deg, label.sigma_deg)
        for label, fused in labelled
        if fused is not None and zero is not None
    ]


def lift_errors(lift: int) -> list[KnownError]:
    """Return the errors of both fingertips in a lift of the second renderer. SIMULATED."""
    cv2.setNumThreads(1)
    return [error for tip, sign in enumerate(SIGNS) for error in _tip_errors(lift, tip, sign)]


def _tip_errors(lift: int, tip: int, sign: int) -> Iterator[KnownError]:
    drawn, course = list(frames(lift, tip)), draw_course(lift)
    background = mean_background([frame.image for frame in islice(drawn, BACKGROUND_FRAMES)])
    answers = _answers(SlipEstimator(background, 1.0), drawn)
    begins = next(place for place, frame in enumerate(drawn) if frame.time_ns >= LIFT_NS)
    zero = _first_from(answers, begins)
    for place in range(begins, len(drawn), LIFT_STRIDE):
        fused, turn = answers[place], course.turn_deg[place - BACKGROUND_FRAMES]
        if fused is not None and zero is not None:
            true_deg = sign * float(turn - course.turn_deg[begins - BACKGROUND_FRAMES])
            yield _known_error(fused, fused.angle_rad - zero, true_deg, 0.0)


def _answers(estimator: SlipEstimator, images: Iterable[TimedImage]) -> list[Fused | None]:
    answers = []
    for frame in images:
        sample = None if frame.image is None else estimator.update(frame.image, frame.time_ns)
        answered = sample is not None and sample.angle_deg is not None
        answers.append(estimator.fused if answered else None)
    return answers


def _first_from(answers: list[Fused | None], place: int) -> float | None:
    """Return the angle of the first answer at or after a frame; if there is none, of the last one before."""
    later = (fused for fused in (*answers[place:], *reversed(answers[:place])) if fused is not None)
    return next((fused.angle_rad for fused in later), None)


def _known_error(fused: Fused, turned_rad: float, true_deg: float, label_deg: float) -> KnownError:
    squared_deg = math.degrees(1.0) ** 2
    terms = fused.weight * fused.terms
    known = fused.variance - float(coefficients() @ terms)
    return KnownError(
        math.degrees(turned_rad) - true_deg,
        label_deg,
        max(known, 0.0) * squared_deg,
        tuple(np.multiply(terms, squared_deg).tolist()),
    )
