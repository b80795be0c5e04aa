"""Estimates for a series of recorded frames: the samples, their common zero, table and figures."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import tee
from time import perf_counter
from typing import Protocol

import numpy as np

from drivers.errors import InputError
from drivers.progress import steps
from drivers.types import ArmState, Image
from rig.frames.series import TimedFrame
from rig.frames.slip_alarm import slips
from rig.frames.times import FrameTime
from rig.sessions.table_files import csv_bytes
from rig.tactile.sample import SlipSample, State, TactileEstimator

TIME_PERCENTILES = (50, 90, 99)
FRAME_MS = "ms per frame with contact: median, 90 %, 99 %"
"""Heading of a column with the values of `frame_ms`."""


class TimedImage(Protocol):
    """A frame with its time."""

    @property
    def image(self) -> Image | None:
        """(H, W, 3) uint8 RGB, None if it could not be read."""
        ...

    @property
    def time_ns(self) -> int:
        """Capture time."""
        ...


@dataclass(frozen=True, slots=True)
class TimedSample:
    """A sample and the wall time in s of its computation, None for a frame that could not be read."""

    sample: SlipSample
    cost_s: float | None


@dataclass(frozen=True, slots=True)
class Answer:
    """The estimator's sample for the frame taken at a time. cost_s: as in `TimedSample`."""

    time: FrameTime
    sample: SlipSample
    cost_s: float | None = None


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimates of one series, with None for values that the estimator refused or does not compute.

    angles_deg, sigmas_deg, shifts_px (x right, y down): from the zero, see `zeroed`. slips: whether the slip
    alarm had been raised, see `rig.frames.slip_alarm`.
    """

    answers: tuple[Answer, ...]
    angles_deg: tuple[float | None, ...]
    sigmas_deg: tuple[float | None, ...]
    rates_deg_s: tuple[float | None, ...]
    shifts_px: tuple[tuple[float, float] | None, ...]
    slips: tuple[bool | None, ...]
    zero: FrameTime | None
    zero_note: str
    unreadable: int


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
) -> Iterator[TimedSample]:
    """Yield the sample of every frame, in order; a frame that could not be read is `lost`.

    states: the arm's states in time order. Before each frame the estimator gets the states up to its time.
    """
    waiting = deque(states)
    for frame in frames:
        if frame.image is None:
            yield TimedSample(SlipSample(frame.time_ns, State.LOST), None)
            continue
        began = perf_counter()
        while waiting and waiting[0].time_ns <= frame.time_ns:
            estimator.arm(waiting.popleft())
        sample = estimator.update(frame.image, frame.time_ns)
        yield TimedSample(sample, perf_counter() - began)


def estimate_together(
    estimators: Mapping[str, TactileEstimator], frames: Iterable[TimedImage]
) -> dict[str, list[TimedSample]]:
    """Return the samples of several estimators by name. All estimate a frame before the next one is read.

    This way each frame is read once, and the estimators can share intermediate results.
    """
    copies = tee(frames, len(estimators))
    loops = (estimate_frames(*of) for of in zip(estimators.values(), copies, strict=True))
    samples: dict[str, list[TimedSample]] = {name: [] for name in estimators}
    for row in zip(*loops, strict=True):
        for of, sample in zip(samples.values(), row, strict=True):
            of.append(sample)
    return samples


def estimate_series(
    series: Iterable[TimedFrame], estimator: TactileEstimator, count: int | None = None
) -> tuple[Answer, ...]:
    """Estimate every frame in order; a frame that cannot be read is `lost`. Raises `InputError`.

    count: number of frames, if known, for the display of progress.
    """
    frames, shown = tee(steps(series, count))
    pairs = zip(frames, estimate_frames(estimator, shown), strict=True)
    return tuple(Answer(frame.time, timed.sample, timed.cost_s) for frame, timed in pairs)


def without_angles(answers: Iterable[Answer]) -> tuple[Answer, ...]:
    """Return the answers without their angles, for frames that do not fit the background."""
    return tuple(replace(answer, sample=answer.sample.without_angle()) for answer in answers)


class Timed(Protocol):
    """A sample with the wall time in s of its computation, None for a frame that could not be read."""

    @property
    def sample(self) -> SlipSample:
        """The sample."""
        ...

    @property
    def cost_s(self) -> float | None:
        """The time."""
        ...


def contact_ms(timed: Iterable[Timed]) -> list[float]:
    """Return the run times of the frames with contact, ms; a frame without contact needs nearly no time."""
    return [1e3 * of.cost_s for of in timed if of.cost_s is not None and of.sample.estimated]


def frame_ms(times_ms: Sequence[float]) -> tuple[float, float, float] | None:
    """Return the percentiles `TIME_PERCENTILES` of run times; None without times."""
    if not times_ms:
        return None
    median_ms, p90_ms, p99_ms = np.percentile(times_ms, TIME_PERCENTILES).tolist()
    return median_ms, p90_ms, p99_ms


def lift_time(answers: Sequence[Answer], lift: FrameTime | None) -> int | None:
    """Return a lift's time in ns, None if unknown. Raises `InputError` outside the series."""
    if lift is not None:
        _check_within(answers, "--lift-from", lift)
    return None if lift is None else lift.time_ns


def zeroed(
    answers: Sequence[Answer],
    reference: FrameTime | None,
    keep_zero: bool = False,
    sign: int = 1,
    lift_ns: int | None = None,
) -> Estimate:
    """Return angles relative to the zero: the answer at the reference time, or where the contact has settled.

    keep_zero: use the estimator's own zero, like the published script. sign: +1, or -1 for a fingertip that
    sees the object from behind. lift_ns: start of the lift, if known. If there is no angle at the reference
    time, the first later answer is the zero. Raises `InputError` for a reference time outside the series.
    """
    unreadable = sum(
        answer.sample.state is State.LOST
        and answer.sample.contact_area_px == 0
        and not (answer.sample.jumped or answer.sample.fault)
        for answer in answers
    )
    place, note = (None, "the zero of the script") if keep_zero else _zero_place(answers, reference)
    zero = None if place is None else answers[place]
    zero_deg = 0.0 if zero is None else zero.sample.angle_deg or 0.0
    samples = [answer.sample for answer in answers]
    return Estimate(
        answers=tuple(answers),
        angles_deg=tuple(None if s.angle_deg is None else sign * (s.angle_deg - zero_deg) for s in samples),
        sigmas_deg=tuple(
            None if s.angle_deg is None else s.sigma_since(zero and zero.sample) for s in samples
        ),
        rates_deg_s=tuple(None if s.rate_deg_s is None else sign * s.rate_deg_s for s in samples),
        shifts_px=tuple(_shifted(s, zero and zero.sample) for s in samples),
        slips=tuple(slips(samples, lift_ns)),
        zero=zero and zero.time,
        zero_note=note,
        unreadable=unreadable,
    )


def rows(estimate: Estimate, mm_per_px: tuple[float, float] | None = None) -> list[dict[str, object]]:
    """Return a row per frame: t_s (text as given), state, slip (0 or 1), figures; None where refused.

    mm_per_px: scale of the gel along x and y. If given, the rows also contain the shift in mm.
    """
    found = [_row(estimate, place) for place in range(len(estimate.answers))]
    if mm_per_px is None:
        return found
    shifts = [shift_mm(shift, mm_per_px) for shift in estimate.shifts_px]
    return [row | {"shift_x_mm": x, "shift_y_mm": y} for row, (x, y) in zip(found, shifts, strict=True)]


def shift_mm(
    shift_px: tuple[float, float] | None, mm_per_px: tuple[float, float]
) -> tuple[float | None, float | None]:
    """Return a shift in mm, right and down; None for both if it is unknown."""
    if shift_px is None:
        return None, None
    return _rounded(shift_px[0] * mm_per_px[0]), _rounded(shift_px[1] * mm_per_px[1])


def table(rows: Sequence[dict[str, object]]) -> str:
    """Return rows as CSV text; refused or unavailable values are empty. rows: at least one."""
    return csv_bytes(dict.fromkeys(rows[0], str), rows).decode()


def figures(estimate: Estimate) -> EstimateFigures:
    """Return the summary of an estimate."""
    refused = Counter(
        answer.sample.state.value
        for answer, angle in zip(estimate.answers, estimate.angles_deg, strict=True)
        if angle is None
    )
    slip = next((a.time.text for a, s in zip(estimate.answers, estimate.slips, strict=True) if s), None)
    median_ms, p90_ms, p99_ms = frame_ms(contact_ms(estimate.answers)) or (None, None, None)
    return EstimateFigures(
        frames=len(estimate.answers),
        answered=len(estimate.answers) - sum(refused.values()),
        refused=dict(sorted(refused.items())),
        unreadable=estimate.unreadable,
        jumped=sum(answer.sample.jumped for answer in estimate.answers),
        reference_time_s=None if estimate.zero is None else float(estimate.zero.text),
        reference=estimate.zero_note,
        slip_s=None if slip is None else float(slip),
        median_ms=_milliseconds(median_ms),
        p90_ms=_milliseconds(p90_ms),
        p99_ms=_milliseconds(p99_ms),
    )


def _row(estimate: Estimate, place: int) -> dict[str, object]:
    answer, slip = estimate.answers[place], estimate.slips[place]
    x, y = estimate.shifts_px[place] or (None, None)
    return {
        "t_s": answer.time.text,
        "angle_deg": _rounded(estimate.angles_deg[place]),
        "sigma_deg": _rounded(estimate.sigmas_deg[place]),
        "state": answer.sample.state.value,
        "rate_deg_s": _rounded(estimate.rates_deg_s[place]),
        "shift_x_px": _rounded(x),
        "shift_y_px": _rounded(y),
        "slip": None if slip is None else int(slip),
    }


def _shifted(sample: SlipSample, zero: SlipSample | None) -> tuple[float, float] | None:
    """Return the shift since the zero, or since the estimator's reference if the zero has none."""
    if sample.shift_px is None:
        return None
    x, y = (zero and zero.shift_px) or (0.0, 0.0)
    return sample.shift_px[0] - x, sample.shift_px[1] - y


def _milliseconds(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _zero_place(answers: Sequence[Answer], reference: FrameTime | None) -> tuple[int | None, str]:
    if reference is not None:
        return _place_at(answers, reference)
    answered = [i for i, answer in enumerate(answers) if answer.sample.angle_deg is not None]
    if not answered:
        return None, "undefined: no frame has an angle"
    settled = next((i for i in answered if answers[i].sample.settled), None)
    if settled is None:
        return answered[0], "at the first frame with an angle; the contact never settled"
    return settled, "at the first frame with an angle in a settled contact"


def _place_at(answers: Sequence[Answer], reference: FrameTime) -> tuple[int | None, str]:
    """Return the frame nearest to the reference time, or the first later frame with an angle."""
    _check_within(answers, "--reference-time", reference)
    place = min(range(len(answers)), key=lambda i: abs(answers[i].time.time_ns - reference.time_ns))
    answered = [i for i, answer in enumerate(answers) if answer.sample.angle_deg is not None]
    if place in answered:
        return place, "at the given reference"
    state = answers[place].sample.state.value
    if not answered:
        return None, f"undefined: no frame has an angle; {state} at --reference-time {reference.text}"
    instead = next((i for i in answered if i > place), answered[0])
    return instead, f"at the first later frame with an angle; {state} at --reference-time {reference.text}"


def _check_within(answers: Sequence[Answer], option: str, time: FrameTime) -> None:
    first, last = answers[0].time, answers[-1].time
    if not first.time_ns <= time.time_ns <= last.time_ns:
        raise InputError(f"{option} {time.text}: the frames run from {first.text} to {last.text} s")
