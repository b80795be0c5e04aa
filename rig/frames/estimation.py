"""One choice of estimator, background and times, applied to series after series."""

from dataclasses import dataclass

from drivers.errors import InputError, counted
from drivers.types import Image
from rig.frames.doubts import background_doubts, frame_doubts
from rig.frames.estimates import Estimate, EstimateFigures, estimate_series, figures, lift_time, zeroed
from rig.frames.of_session import SessionSeries
from rig.frames.series import FrameSeries, make_background
from rig.frames.times import FrameTime, parse_time
from rig.tactile.estimators import ESTIMATORS, PUBLISHED, TOSKOV, EstimatorChoice
from rig.tactile.foreign import faults_of


@dataclass(frozen=True, slots=True)
class SeriesEstimate:
    """One series' estimate.

    untouched: the background, (H, W, 3) uint8 RGB; background: where it is from. doubts: what is amiss with
    frames or background. angles_from: what of the frames the angles come from.
    """

    estimate: Estimate
    untouched: Image
    background: str
    doubts: tuple[str, ...]
    angles_from: str

    @property
    def figures(self) -> EstimateFigures:
        """What the estimate amounts to."""
        return figures(self.estimate)

    @property
    def warnings(self) -> list[str]:
        """The doubts, and what came out amiss."""
        found, more = self.figures, list(self.doubts)
        if faults := faults_of(answer.sample for answer in self.estimate.answers):
            more.append(str(faults))
        if found.unreadable:
            more.append(f"{counted(found.unreadable, 'frame')} could not be read: 'lost' in the table")
        if found.jumped:
            more.append(
                f"{counted(found.jumped, 'frame')} with a time far from those around it: 'lost' in the table"
            )
        if found.refused == {"no_contact": found.frames}:
            more.append("no frame shows a contact; where one should, the background shows the same contact")
        return more


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedSeries:
    """Frames and their estimate. name: of the clip or the sensor. sign: of the image angle in its angles."""

    name: str
    frames: FrameSeries
    done: SeriesEstimate
    sign: int = 1


class Estimation:
    """What is asked of every series.

    background: as `make_background` takes it. reference_time, lift_from: times in s, as text. aspect: width
    over height of a pixel on the gel. Raises `InputError` for what cannot be.
    """

    def __init__(
        self,
        choice: EstimatorChoice,
        background: str | None = None,
        reference_time: str | None = None,
        lift_from: str | None = None,
        aspect: float | None = None,
    ) -> None:
        if choice.name == TOSKOV:
            raise InputError(
                f"the estimator '{TOSKOV}' feels at the arm's wrist and frames do not tell that: use it in "
                f"lifts, with rig trial, or rig replay SESSION --estimator {TOSKOV}"
            )
        self.choice, self._background, self._aspect = choice, background, aspect
        self._published = choice.name.endswith(PUBLISHED) and choice.name in ESTIMATORS
        self._reference = _time("--reference-time", reference_time)
        self.lift = _time("--lift-from", lift_from)
        if self._published and self._reference is not None:
            raise InputError(
                f"{choice.name} takes its zero itself, as the script does: leave --reference-time out"
            )

    def of_series(self, series: FrameSeries) -> SeriesEstimate:
        """Estimate anyone's frames. Raises `InputError`."""
        background, note = make_background(self._background, series)
        doubts = [*background_doubts(self._background, background, series), *frame_doubts(series)]
        estimate = self._estimate(series, background, self._aspect, 1, None)
        return SeriesEstimate(estimate, background, note, tuple(doubts), self.choice.sees(background))

    def of_sensor(self, tip: SessionSeries) -> SeriesEstimate:
        """Estimate a session's frames, with what it knows of their sensor. Raises `InputError`."""
        if self._background is None:
            background, note, doubts = tip.background, "background: the session's own", []
        else:
            background, note = make_background(self._background, tip.frames)
            doubts = background_doubts(self._background, background, tip.frames)
        estimate = self._estimate(tip.frames, background, self._aspect or tip.aspect, tip.sign, tip.lift_ns)
        doubts += frame_doubts(tip.frames)
        return SeriesEstimate(estimate, background, note, tuple(doubts), self.choice.sees(background))

    def _estimate(
        self, series: FrameSeries, background: Image, aspect: float | None, sign: int, lift_ns: int | None
    ) -> Estimate:
        answers = estimate_series(series, self.choice.make(background, aspect))
        if not answers:
            raise InputError(f"{series.name}: holds no frames to estimate: give another clip or recording")
        lift_ns = lift_time(answers, self.lift) if lift_ns is None else lift_ns
        return zeroed(answers, self._reference, self._published, 1 if self._published else sign, lift_ns)


def _time(option: str, text: str | None) -> FrameTime | None:
    time = None if text is None else parse_time(text)
    if text is not None and time is None:
        raise InputError(f"{option} '{text}' is not a time in s")
    return time
