"""Estimates for series of recorded frames: samples, common zero, table, figures, warnings about the input."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, tee
from pathlib import Path
from time import perf_counter

import numpy as np

from calibration.store import load
from drivers.errors import CalibrationError, FormatError, InputError, plural
from drivers.progress import steps
from drivers.types import ArmState, Image
from rig.frames.of_session import SessionSeries
from rig.frames.series import FrameSeries, TimedFrame, evenly_spread, make_background
from rig.frames.slip_alarm import slips
from rig.frames.times import FrameTime, parse_time, spacing_notes
from rig.sessions.table_files import csv_bytes
from rig.tactile.angles import Angles
from rig.tactile.contact.background_check import LOOKS_LIKE_CONTACT, BackgroundCheck
from rig.tactile.contact.untouched import Comparison
from rig.tactile.estimators import ESTIMATORS, PUBLISHED, TOSKOV, EstimatorChoice
from rig.tactile.sample import (
    FROZEN,
    NO_COLOUR,
    EstimatorFaults,
    SlipSample,
    State,
    TactileEstimator,
    TimedImage,
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
MOVING_SIGMAS = 3.0
"""Standard deviations of a change of the angle that is not noise."""
CHECKED_FRAMES = 24
"""A background is checked with this many to twice as many frames of a recording, after the last one; each
takes about 1 ms."""
TIME_PERCENTILES = (50, 90, 99)
FRAME_MS = "ms per frame with contact: median, 90 %, 99 %"
"""Heading of a column with the values of `frame_ms`."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimates of one series.

    times, samples: of the frames, in order. zero: time of the frame whose angle is 0, see `apply_zero`; None
    without one, the angles are then the estimator's own. zero_note: which frame that is.
    """

    times: tuple[FrameTime, ...]
    samples: tuple[SlipSample, ...]
    zero: FrameTime | None = None
    zero_note: str = ""

    @property
    def angles(self) -> Angles:
        times_ns = [time.time_ns for time in self.times]
        return Angles.of(replace(s, time_ns=t) for s, t in zip(self.samples, times_ns, strict=True))

    @property
    def unreadable(self) -> int:
        return sum(sample.cost_s is None for sample in self.samples)


@dataclass(frozen=True, slots=True)
class EstimateFigures:
    """Summary of an estimate. refused: number of frames by state.

    slip_s: time of the first slip alarm, None without one. median_ms, p90_ms, p99_ms: wall time per frame
    with contact, None without such a frame.
    """

    frames: int
    answered: int
    refused: dict[str, int]
    unreadable: int
    jumped: int
    reference_time_s: float | None
    reference: str
    slip_s: float | None
    median_ms: float | None
    p90_ms: float | None
    p99_ms: float | None


def estimate_frames(
    estimator: TactileEstimator, frames: Iterable[TimedImage], states: Iterable[ArmState] = ()
) -> Iterator[SlipSample]:
    """Yield the sample of every frame, in order, with its `cost_s`; an unreadable frame is `lost`.

    states: the arm's states in time order. Before each frame the estimator gets the states up to its time.
    """
    waiting = deque(states)
    for frame in frames:
        if frame.image is None:
            yield SlipSample(frame.time_ns, State.LOST)
            continue
        began = perf_counter()
        while waiting and waiting[0].time_ns <= frame.time_ns:
            estimator.arm(waiting.popleft())
        sample = estimator.update(frame.image, frame.time_ns)
        yield replace(sample, cost_s=perf_counter() - began)


def estimate_together(
    estimators: Mapping[str, TactileEstimator], frames: Iterable[TimedImage]
) -> dict[str, list[SlipSample]]:
    """Return the samples of several estimators by name. All estimate a frame before the next one is read.

    This way each frame is read once, and the estimators can share intermediate results.
    """
    copies = tee(frames, len(estimators))
    loops = (estimate_frames(*of) for of in zip(estimators.values(), copies, strict=True))
    samples: dict[str, list[SlipSample]] = {name: [] for name in estimators}
    for row in zip(*loops, strict=True):
        for of, sample in zip(samples.values(), row, strict=True):
            of.append(sample)
    return samples


def estimate_series(
    series: Iterable[TimedFrame], estimator: TactileEstimator, count: int | None = None
) -> Estimate:
    """Estimate every frame in order; a frame that cannot be read is `lost`. Raises `InputError`.

    count: number of frames, if known, for the display of progress.
    """
    pairs = [(frame.time, sample) for frame, sample in _estimate_pairs(series, estimator, count)]
    return Estimate(tuple(time for time, _ in pairs), tuple(sample for _, sample in pairs))


def _estimate_pairs(
    series: Iterable[TimedFrame], estimator: TactileEstimator, count: int | None
) -> Iterator[tuple[TimedFrame, SlipSample]]:
    frames, shown = tee(steps(series, count))
    return zip(frames, estimate_frames(estimator, shown), strict=True)


def estimate_checked(
    series: FrameSeries, estimator: TactileEstimator, background: Image
) -> tuple[Estimate, BackgroundCheck]:
    """Estimate every frame as `estimate_series` does, then check the background with some of the frames.

    The estimate has no angles if the check finds that the frames do not fit. Raises `InputError`.
    """
    times, samples = list[FrameTime](), list[SlipSample]()

    def estimate_each() -> Iterator[TimedFrame]:
        for frame, sample in _estimate_pairs(series, estimator, series.count):
            times.append(frame.time)
            samples.append(sample)
            yield frame

    check = BackgroundCheck(background)
    for frame in evenly_spread(estimate_each(), CHECKED_FRAMES):
        if frame.image is not None:
            check.check(frame.image, frame.time_ns)
    found = Estimate(tuple(times), tuple(samples))
    if check.misfit:
        found = replace(found, samples=tuple(sample.without_angle() for sample in found.samples))
    return found, check


def contact_ms(samples: Iterable[SlipSample]) -> list[float]:
    """Return the run times of the frames with contact, ms; a frame without contact needs nearly no time."""
    return [1e3 * of.cost_s for of in samples if of.cost_s is not None and of.estimated]


def frame_ms(times_ms: Sequence[float]) -> tuple[float, float, float] | None:
    """Return the percentiles `TIME_PERCENTILES` of run times; None without times."""
    if not times_ms:
        return None
    median_ms, p90_ms, p99_ms = np.percentile(times_ms, TIME_PERCENTILES).tolist()
    return median_ms, p90_ms, p99_ms


def apply_zero(
    estimate: Estimate,
    reference: FrameTime | None,
    keep_zero: bool = False,
    sign: int = 1,
    lift_ns: int | None = None,
) -> Estimate:
    """Return angles relative to the zero: the frame at the reference time, or where the contact has settled.

    Shifts are relative to it, too, or to the estimator's reference if the zero has none; `slip` is set.
    keep_zero: use the estimator's own zero, like the published script. sign: +1, or -1 for a fingertip that
    sees the object from behind. lift_ns: start of the lift, if known. If there is no angle at the reference
    time, the first later one is the zero. Raises `InputError` for a reference time outside the series.
    """
    place, note = (None, "the zero of the script") if keep_zero else _zero_place(estimate, reference)
    zero = None if place is None else estimate.samples[place]
    zero_deg = (zero and zero.angle_deg) or 0.0
    x, y = (zero and zero.shift_px) or (0.0, 0.0)
    samples = []
    for sample, slip in zip(estimate.samples, slips(estimate.samples, lift_ns), strict=True):
        shift_px = sample.shift_px and (sample.shift_px[0] - x, sample.shift_px[1] - y)
        samples.append(replace(sample.since_zero(sign, zero_deg, zero), shift_px=shift_px, slip=slip))
    return Estimate(estimate.times, tuple(samples), None if place is None else estimate.times[place], note)


def rows(estimate: Estimate, mm_per_px: tuple[float, float] | None = None) -> list[dict[str, object]]:
    """Return a row per frame: t_s (text as given), state, slip (0 or 1), figures; None where refused.

    mm_per_px: scale of the gel along x and y. If given, the rows also contain the shift in mm.
    """
    found: list[dict[str, object]] = []
    for time, sample in zip(estimate.times, estimate.samples, strict=True):
        x, y = sample.shift_px or (None, None)
        found.append(
            {
                "t_s": time.text,
                "angle_deg": _round(sample.angle_deg),
                "sigma_deg": _round(sample.sigma_deg),
                "state": sample.state.value,
                "rate_deg_s": _round(sample.rate_deg_s),
                "shift_x_px": _round(x),
                "shift_y_px": _round(y),
                "slip": None if sample.slip is None else int(sample.slip),
            }
        )
        if mm_per_px is not None:
            x, y = shift_mm(sample.shift_px, mm_per_px)
            found[-1] |= {"shift_x_mm": x, "shift_y_mm": y}
    return found


def read_scale(path: Path) -> tuple[float, float]:
    """Read mm per pixel along x and y from a file of `rig calibrate tactile`. Raises `CalibrationError`."""
    value = load(path, "tactile").value
    try:
        across, along = (float(v) for v in value["mm_per_px"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{path}: holds no mm_per_px; press balls with rig calibrate tactile"
        ) from error
    return across, along


def shift_mm(
    shift_px: tuple[float, float] | None, mm_per_px: tuple[float, float]
) -> tuple[float | None, float | None]:
    """Return a shift in mm, right and down; None for both if it is unknown."""
    if shift_px is None:
        return None, None
    return _round(shift_px[0] * mm_per_px[0]), _round(shift_px[1] * mm_per_px[1])


def table(rows: Sequence[dict[str, object]]) -> str:
    """Return rows as CSV text; refused or unavailable values are empty. rows: at least one."""
    return csv_bytes(dict.fromkeys(rows[0], str), rows).decode()


def figures(estimate: Estimate) -> EstimateFigures:
    samples = estimate.samples
    refused = Counter(sample.state.value for sample in samples if sample.angle_deg is None)
    slip = next((time.text for time, s in zip(estimate.times, samples, strict=True) if s.slip), None)
    times_ms = frame_ms(contact_ms(samples))
    median_ms, p90_ms, p99_ms = (round(ms, 3) for ms in times_ms) if times_ms else (None, None, None)
    return EstimateFigures(
        frames=len(samples),
        answered=len(samples) - sum(refused.values()),
        refused=dict(sorted(refused.items())),
        unreadable=estimate.unreadable,
        jumped=sum(sample.jumped for sample in samples),
        reference_time_s=None if estimate.zero is None else float(estimate.zero.text),
        reference=estimate.zero_note,
        slip_s=None if slip is None else float(slip),
        median_ms=median_ms,
        p90_ms=p90_ms,
        p99_ms=p99_ms,
    )


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _motion_at(samples: Sequence[SlipSample], zero: int) -> str:
    """Return a warning if the object was turning at the zero; empty if not.

    It was if the angle has changed by more than three sigma since the frame before, which showed the contact.
    """
    before, sigma_deg = samples[zero - 1] if zero else samples[zero], samples[zero].sigma_deg
    if before.angle_deg is None or sigma_deg is None or samples[zero].state is State.REKEYED:
        return ""
    turned_deg = (samples[zero].angle_deg or 0.0) - before.angle_deg
    if abs(turned_deg) <= MOVING_SIGMAS * sigma_deg:
        return ""
    return (
        f", in which the object was turning ({turned_deg:+.1f} degrees since the frame before): "
        "name a frame at rest with --reference-time"
    )


def _zero_place(estimate: Estimate, reference: FrameTime | None) -> tuple[int | None, str]:
    """Return the number of the frame whose angle is 0, and a note; None without an angle."""
    times, samples = estimate.times, estimate.samples
    answered = [i for i, sample in enumerate(samples) if sample.angle_deg is not None]
    if reference is None:
        if not answered:
            return None, "undefined: no frame has an angle"
        settled = next((i for i in answered if samples[i].settled), None)
        if settled is None:
            return answered[0], "at the first frame with an angle; the contact never settled"
        note = "at the first frame with an angle in a settled contact"
        return settled, note + _motion_at(samples, settled)
    _check_within(estimate, "--reference-time", reference)
    place = min(range(len(times)), key=lambda i: abs(times[i].time_ns - reference.time_ns))
    if place in answered:
        return place, "at the given reference"
    state = f"{samples[place].state.value} at --reference-time {reference.text}"
    if not answered:
        return None, f"undefined: no frame has an angle; {state}"
    instead = next((i for i in answered if i > place), answered[0])
    return instead, f"at the first later frame with an angle; {state}"


def _check_within(estimate: Estimate, option: str, time: FrameTime) -> None:
    first, last = estimate.times[0], estimate.times[-1]
    if not first.time_ns <= time.time_ns <= last.time_ns:
        raise InputError(f"{option} {time.text}: the frames run from {first.text} to {last.text} s")


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
    second, *later = after
    comparison = Comparison(second)
    if comparison.region(first) is not None and all(comparison.region(image) is None for image in later):
        return [
            "the first frame differs from all frames after it: leave it out if it is an old frame from the "
            "camera's buffer"
        ]
    return []


def background_doubts(spec: str | None, background: Image, series: FrameSeries) -> list[str]:
    """Return a warning if the frames of `first:N` are not alike. spec: as for `make_background`."""
    if spec is None or not spec.startswith("first:"):
        return []
    images, comparison = islice(series.images(), int(spec.removeprefix("first:"))), Comparison(background)
    if odd := [number for number, image in enumerate(images) if comparison.region(image) is not None]:
        return [
            f"the frames of --background {spec} are not alike (frame {odd[0]} differs): a contact begins "
            "during them, or one is an old frame; give fewer frames or an IMAGE"
        ]
    return []


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedSeries:
    """Frames and their estimate.

    name: clip or sensor. sign: factor from image angles to the angles here. untouched: the background,
    (H, W, 3) uint8 RGB; background: its origin. doubts: warnings about frames or background. angles_from: the
    image content that the angles are based on.
    """

    name: str
    frames: FrameSeries
    sign: int
    estimate: Estimate
    untouched: Image
    background: str
    doubts: tuple[str, ...]
    angles_from: str

    @property
    def figures(self) -> EstimateFigures:
        return figures(self.estimate)

    def lines(self) -> list[str]:
        """The figures for people, one in each line; the last line is the last angle."""
        found, start = self.figures, float(self.estimate.times[0].text)
        refused = ", ".join(f"{count} {state}" for state, count in found.refused.items()) or "none"
        zero, slip = (
            "" if t is None else f"{text}{t - start:.3f} s after the first frame"
            for text, t in ((", ", found.reference_time_s), ("slip ", found.slip_s))
        )
        timed = "no frame with contact was timed"
        if found.median_ms is not None:
            times = f"median; 90 % {found.p90_ms:.1f}, 99 % {found.p99_ms:.1f}"
            timed = f"{found.median_ms:.1f} ms per frame with contact ({times})"
        pairs = zip(self.estimate.times, self.estimate.samples, strict=True)
        last = "last angle: none"
        for time, sample in pairs:
            if sample.angle_deg is not None:
                sigma = "" if sample.sigma_deg is None else f", sigma {sample.sigma_deg:.2f}"
                last = f"last angle: {sample.angle_deg:+.2f} deg{sigma}, at {time.text} s"
        return [
            f"{plural(found.frames, 'frame')}, {found.answered} answered, refused: {refused}",
            f"angles from {self.angles_from}; {timed}",
            f"0 degrees is {found.reference}{zero}",
            *([slip] if slip else []),
            last,
        ]

    @property
    def faults(self) -> EstimatorFaults | None:
        return faults_of(self.estimate.samples)

    @property
    def warnings(self) -> list[str]:
        found = self.figures
        more = [*self.doubts, *spacing_notes([time.time_ns for time in self.estimate.times])]
        if found.unreadable:
            more.append(f"{plural(found.unreadable, 'frame')} could not be read: 'lost' in the table")
        if found.jumped:
            more.append(
                f"{plural(found.jumped, 'frame')} with a time far from those around it, or not after that "
                "of the frame before: 'lost' in the table"
            )
        if frozen := found.refused.get(State.FROZEN.value):
            more.append(f"{plural(frozen, 'frame')}: {FROZEN}")
        if found.refused == {"no_contact": found.frames}:
            more.append("no frame shows a contact; if one should, the background shows the same contact")
        return more


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

    def of_series(self, source: FrameSeries | SessionSeries) -> EstimatedSeries:
        """Estimate the frames of a clip, or those of a sensor in a session. Raises `InputError`.

        A sensor has its own sign and start of the lift, and, unless they are given here, background and
        pixel aspect; slopes are computed with its look.
        """
        if isinstance(source, SessionSeries):
            series, name, sign, lift_ns = source.frames, source.serial, source.sign, source.lift_ns
            choice, aspect, own = replace(self.choice, gel=source.gel), source.aspect, source.background
        else:
            series, name, sign, lift_ns = source, Path(source.name).name, 1, None
            choice, aspect, own = self.choice, None, None
        if self._background is None and own is not None:
            background, note = own, "background: the session's own"
        else:
            background, note = make_background(self._background, series)
        doubts = background_doubts(self._background, background, series)
        raw, check = estimate_checked(series, choice.make(background, self._aspect or aspect), background)
        if not raw.samples:
            raise InputError(f"{series.name}: holds no frames to estimate: give another clip or recording")
        if lift_ns is None and self.lift is not None:
            _check_within(raw, "--lift-from", self.lift)
            lift_ns = self.lift.time_ns
        to_object = 1 if self._published else sign
        estimate = apply_zero(raw, self._reference, self._published, to_object, lift_ns)
        if check.misfit:
            remedy = "give a background of the same camera position, or --background auto"
            doubts.append(f"no angles: {check.doubt_with(remedy)}")
        elif check.doubt:
            doubts.append(CONTACT_IN_BACKGROUND)
        doubts += frame_doubts(series)
        sees = self.choice.sees(background)
        return EstimatedSeries(name, series, sign, estimate, background, note, tuple(doubts), sees)


def _time(option: str, text: str | None) -> FrameTime | None:
    try:
        return None if text is None else parse_time(text)
    except FormatError as error:
        raise InputError(f"{option} {error}: give a time in s") from error
