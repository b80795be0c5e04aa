"""Estimation of any number of series with one estimator; warnings about doubtful input."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from drivers.errors import FormatError, InputError, counted
from drivers.types import Image
from rig.frames.estimates import (
    Estimate,
    EstimateFigures,
    estimate_series,
    figures,
    lift_time,
    without_angles,
    zeroed,
)
from rig.frames.of_session import SessionSeries
from rig.frames.series import FrameSeries, TimedFrame, make_background
from rig.frames.times import FrameTime, parse_time, sparse_note
from rig.tactile.contact.background_check import LOOKS_LIKE_CONTACT, BackgroundCheck
from rig.tactile.contact.untouched import Comparison
from rig.tactile.estimators import ESTIMATORS, PUBLISHED, TOSKOV, EstimatorChoice
from rig.tactile.sample import (
    FROZEN,
    NO_COLOUR,
    EstimatorFaults,
    State,
    TactileEstimator,
    faults_of,
    has_colour,
)

# The first frame is compared with this many later ones. It counts as dark if its mean brightness is below
# this share of theirs.
AFTER_FIRST = 5
DARK_SHARE = 0.7
CONTACT_IN_BACKGROUND = (
    f"{LOOKS_LIKE_CONTACT} that other frames do not show: give an IMAGE without contact, or --background auto"
)


def frame_doubts(series: FrameSeries) -> list[str]:
    """Return warnings about frames without colour, and about a first frame that is stale or too dark."""
    images = list(islice(series.images(), 1 + AFTER_FIRST))
    if images and not any(has_colour(image) for image in images):
        return [NO_COLOUR]
    if len(images) <= AFTER_FIRST:
        return []
    first, *after = images
    light = float(np.median([image.mean() for image in after]))
    if first.mean() < DARK_SHARE * light:
        return [f"the first frame is dark (mean {first.mean():.0f}, the next ones {light:.0f}): leave it out"]
    if _differs(after[0], first) and not any(_differs(after[0], image) for image in after[1:]):
        return [
            "the first frame differs from all frames after it: leave it out if it is an old frame from the "
            "camera's buffer"
        ]
    return []


def background_doubts(spec: str | None, background: Image, series: FrameSeries) -> list[str]:
    """Return a warning if the frames of `first:N` are not alike. spec: as for `make_background`."""
    if spec is None or not spec.startswith("first:"):
        return []
    images = list(islice(series.images(), int(spec.removeprefix("first:"))))
    if odd := _odd_ones(background, images):
        return [
            f"the frames of --background {spec} are not alike (frame {odd[0]} differs): a contact begins "
            "during them, or one is an old frame; give fewer frames or an IMAGE"
        ]
    return []


def _odd_ones(background: Image, images: Sequence[Image]) -> list[int]:
    comparison = Comparison(background)
    return [number for number, image in enumerate(images) if comparison.region(image) is not None]


def _differs(background: Image, image: Image) -> bool:
    return Comparison(background).region(image) is not None


@dataclass(frozen=True, slots=True)
class SeriesEstimate:
    """One series' estimate.

    untouched: the background, (H, W, 3) uint8 RGB; background: its origin. doubts: warnings about frames or
    background. angles_from: the image content that the angles are based on.
    """

    estimate: Estimate
    untouched: Image
    background: str
    doubts: tuple[str, ...]
    angles_from: str

    @property
    def figures(self) -> EstimateFigures:
        """The summary of the estimate."""
        return figures(self.estimate)

    @property
    def text(self) -> str:
        """The figures in one line for people."""
        found, start = self.figures, float(self.estimate.answers[0].time.text)
        refused = ", ".join(f"{count} {state}" for state, count in found.refused.items()) or "none"
        zero, slip = (
            "" if t is None else f"{text}{t - start:.3f} s after the first frame"
            for text, t in ((", ", found.reference_time_s), ("; slip ", found.slip_s))
        )
        return (
            f"{counted(found.frames, 'frame')}, {found.answered} answered, refused: {refused}; "
            f"angles from {self.angles_from}; 0 degrees is {found.reference}{zero}{slip}; {_time_text(found)}"
        )

    @property
    def faults(self) -> EstimatorFaults | None:
        """Faults of a user-defined estimator; None if there are none."""
        return faults_of(answer.sample for answer in self.estimate.answers)

    @property
    def warnings(self) -> list[str]:
        """The doubts, and warnings about the results."""
        found, more = self.figures, list(self.doubts)
        if note := sparse_note([answer.time.time_ns for answer in self.estimate.answers]):
            more.append(note)
        if found.unreadable:
            more.append(f"{counted(found.unreadable, 'frame')} could not be read: 'lost' in the table")
        if found.jumped:
            more.append(
                f"{counted(found.jumped, 'frame')} with a time far from those around it, or not after that "
                "of the frame before: 'lost' in the table"
            )
        if frozen := found.refused.get(State.FROZEN.value):
            more.append(f"{counted(frozen, 'frame')}: {FROZEN}")
        if found.refused == {"no_contact": found.frames}:
            more.append("no frame shows a contact; if one should, the background shows the same contact")
        return more


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedSeries:
    """Frames and their estimate. name: clip or sensor. sign: factor from image angles to the angles here."""

    name: str
    frames: FrameSeries
    done: SeriesEstimate
    sign: int = 1


def require_frames_suffice(choice: EstimatorChoice) -> None:
    """Raise `InputError` for an estimator that needs the arm's states beside the frames."""
    if choice.name == TOSKOV:
        raise InputError(
            f"the estimator '{TOSKOV}' needs the wrench at the arm's wrist, which a clip does not contain: "
            f"use it in lifts, with rig trial, or rig replay SESSION --estimator {TOSKOV}"
        )


class Estimation:
    """Settings that apply to every series.

    background: as for `make_background`. reference_time, lift_from: times in s, as text. aspect: width
    over height of a pixel on the gel. Raises `InputError` for invalid settings.
    """

    def __init__(
        self,
        choice: EstimatorChoice,
        background: str | None = None,
        reference_time: str | None = None,
        lift_from: str | None = None,
        aspect: float | None = None,
    ) -> None:
        require_frames_suffice(choice)
        self.choice, self._background, self._aspect = choice, background, aspect
        self._published = choice.name.endswith(PUBLISHED) and choice.name in ESTIMATORS
        self._reference = _time("--reference-time", reference_time)
        self.lift = _time("--lift-from", lift_from)
        if self._published and self._reference is not None:
            raise InputError(
                f"{choice.name} sets its own zero, as the published script does: leave --reference-time out"
            )

    def of_series(self, series: FrameSeries) -> SeriesEstimate:
        """Estimate the frames of any source. Raises `InputError`."""
        background, note = make_background(self._background, series)
        doubts = background_doubts(self._background, background, series)
        estimator = self.choice.make(background, self._aspect)
        return self._estimate(series, estimator, background, note, doubts)

    def of_sensor(self, tip: SessionSeries) -> SeriesEstimate:
        """Estimate a session's frames with the sensor's sign, background and aspect. Raises `InputError`."""
        if self._background is None:
            background, note, doubts = tip.background, "background: the session's own", []
        else:
            background, note = make_background(self._background, tip.frames)
            doubts = background_doubts(self._background, background, tip.frames)
        estimator = replace(self.choice, gel=tip.gel).make(background, self._aspect or tip.aspect)
        return self._estimate(tip.frames, estimator, background, note, doubts, tip.sign, tip.lift_ns)

    def _estimate(
        self,
        series: FrameSeries,
        estimator: TactileEstimator,
        background: Image,
        note: str,
        doubts: list[str],
        sign: int = 1,
        lift_ns: int | None = None,
    ) -> SeriesEstimate:
        check = BackgroundCheck(background)
        answers = estimate_series(checked(series, check), estimator, series.count)
        if not answers:
            raise InputError(f"{series.name}: holds no frames to estimate: give another clip or recording")
        if check.misfit:
            answers = without_angles(answers)
        lift_ns = lift_time(answers, self.lift) if lift_ns is None else lift_ns
        sign = 1 if self._published else sign
        estimate = zeroed(answers, self._reference, self._published, sign, lift_ns)
        doubts = [*doubts, *_check_doubts(check), *frame_doubts(series)]
        return SeriesEstimate(estimate, background, note, tuple(doubts), self.choice.sees(background))


def _check_doubts(check: BackgroundCheck) -> list[str]:
    """Return a warning if the background is doubtful, with the remedy for recorded frames."""
    if check.misfit:
        return [
            f"{check.misfit}; no angles: give a background of the same camera position, or --background auto"
        ]
    return [CONTACT_IN_BACKGROUND] if check.doubt else []


def checked(series: FrameSeries, check: BackgroundCheck) -> Iterator[TimedFrame]:
    """Yield the frames of a series, after each was compared with the background."""
    for frame in series:
        if frame.image is not None:
            check.add(frame.image, frame.time_ns)
        yield frame


def _time_text(found: EstimateFigures) -> str:
    """Return the time per frame; frames without contact, which need nearly no time, do not count."""
    if found.median_ms is None:
        return "no frame with contact was timed"
    times = f"90 % {found.p90_ms:.1f}, 99 % {found.p99_ms:.1f}"
    return f"{found.median_ms:.1f} ms per frame with contact (median; {times})"


def _time(option: str, text: str | None) -> FrameTime | None:
    try:
        return None if text is None else parse_time(text)
    except FormatError as error:
        raise InputError(f"{option} {error}: give a time in s") from error
