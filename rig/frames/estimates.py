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
from rig.tactile.angles import Angles
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
class Estimate:
    """The estimates of one series.

    times, samples: of the frames, in order. zero: time of the frame whose angle is 0, see `zeroed`; None
    without one, the angles are then the estimator's own. zero_note: which frame that is.
    """

    times: tuple[FrameTime, ...]
    samples: tuple[SlipSample, ...]
    zero: FrameTime | None = None
    zero_note: str = ""

    @property
    def angles(self) -> Angles:
        """The angles in order of the frames' times."""
        times_ns = [time.time_ns for time in self.times]
        return Angles.of(replace(s, time_ns=t) for s, t in zip(self.samples, times_ns, strict=True))

    @property
    def unreadable(self) -> int:
        """Number of frames that could not be read."""
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
    frames, shown = tee(steps(series, count))
    pairs = [(frame.time, s) for frame, s in zip(frames, estimate_frames(estimator, shown), strict=True)]
    return Estimate(tuple(time for time, _ in pairs), tuple(sample for _, sample in pairs))


def without_angles(estimate: Estimate) -> Estimate:
    """Return the estimate without its angles, for frames that do not fit the background."""
    return replace(estimate, samples=tuple(sample.without_angle() for sample in estimate.samples))


def contact_ms(samples: Iterable[SlipSample]) -> list[float]:
    """Return the run times of the frames with contact, ms; a frame without contact needs nearly no time."""
    return [1e3 * of.cost_s for of in samples if of.cost_s is not None and of.estimated]


def frame_ms(times_ms: Sequence[float]) -> tuple[float, float, float] | None:
    """Return the percentiles `TIME_PERCENTILES` of run times; None without times."""
    if not times_ms:
        return None
    median_ms, p90_ms, p99_ms = np.percentile(times_ms, TIME_PERCENTILES).tolist()
    return median_ms, p90_ms, p99_ms


def lift_time(estimate: Estimate, lift: FrameTime | None) -> int | None:
    """Return a lift's time in ns, None if unknown. Raises `InputError` outside the series."""
    if lift is not None:
        _check_within(estimate, "--lift-from", lift)
    return None if lift is None else lift.time_ns


def zeroed(
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
    alarms = slips(estimate.samples, lift_ns)
    samples = tuple(
        replace(sample.turned(sign, zero_deg, zero), shift_px=_shifted(sample, zero), slip=slip)
        for sample, slip in zip(estimate.samples, alarms, strict=True)
    )
    return Estimate(estimate.times, samples, None if place is None else estimate.times[place], note)


def rows(estimate: Estimate, mm_per_px: tuple[float, float] | None = None) -> list[dict[str, object]]:
    """Return a row per frame: t_s (text as given), state, slip (0 or 1), figures; None where refused.

    mm_per_px: scale of the gel along x and y. If given, the rows also contain the shift in mm.
    """
    found = [_row(*of) for of in zip(estimate.times, estimate.samples, strict=True)]
    if mm_per_px is None:
        return found
    shifts = [shift_mm(sample.shift_px, mm_per_px) for sample in estimate.samples]
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
    samples = estimate.samples
    refused = Counter(sample.state.value for sample in samples if sample.angle_deg is None)
    slip = next((time.text for time, s in zip(estimate.times, samples, strict=True) if s.slip), None)
    median_ms, p90_ms, p99_ms = frame_ms(contact_ms(samples)) or (None, None, None)
    return EstimateFigures(
        frames=len(samples),
        answered=len(samples) - sum(refused.values()),
        refused=dict(sorted(refused.items())),
        unreadable=estimate.unreadable,
        jumped=sum(sample.jumped for sample in samples),
        reference_time_s=None if estimate.zero is None else float(estimate.zero.text),
        reference=estimate.zero_note,
        slip_s=None if slip is None else float(slip),
        median_ms=_milliseconds(median_ms),
        p90_ms=_milliseconds(p90_ms),
        p99_ms=_milliseconds(p99_ms),
    )


def _row(time: FrameTime, sample: SlipSample) -> dict[str, object]:
    x, y = sample.shift_px or (None, None)
    return {
        "t_s": time.text,
        "angle_deg": _rounded(sample.angle_deg),
        "sigma_deg": _rounded(sample.sigma_deg),
        "state": sample.state.value,
        "rate_deg_s": _rounded(sample.rate_deg_s),
        "shift_x_px": _rounded(x),
        "shift_y_px": _rounded(y),
        "slip": None if sample.slip is None else int(sample.slip),
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


def _zero_place(estimate: Estimate, reference: FrameTime | None) -> tuple[int | None, str]:
    if reference is not None:
        return _place_at(estimate, reference)
    answered = [i for i, sample in enumerate(estimate.samples) if sample.angle_deg is not None]
    if not answered:
        return None, "undefined: no frame has an angle"
    settled = next((i for i in answered if estimate.samples[i].settled), None)
    if settled is None:
        return answered[0], "at the first frame with an angle; the contact never settled"
    return settled, "at the first frame with an angle in a settled contact"


def _place_at(estimate: Estimate, reference: FrameTime) -> tuple[int | None, str]:
    """Return the frame nearest to the reference time, or the first later frame with an angle."""
    _check_within(estimate, "--reference-time", reference)
    times, samples = estimate.times, estimate.samples
    place = min(range(len(times)), key=lambda i: abs(times[i].time_ns - reference.time_ns))
    answered = [i for i, sample in enumerate(samples) if sample.angle_deg is not None]
    if place in answered:
        return place, "at the given reference"
    state = samples[place].state.value
    if not answered:
        return None, f"undefined: no frame has an angle; {state} at --reference-time {reference.text}"
    instead = next((i for i in answered if i > place), answered[0])
    return instead, f"at the first later frame with an angle; {state} at --reference-time {reference.text}"


def _check_within(estimate: Estimate, option: str, time: FrameTime) -> None:
    first, last = estimate.times[0], estimate.times[-1]
    if not first.time_ns <= time.time_ns <= last.time_ns:
        raise InputError(f"{option} {time.text}: the frames run from {first.text} to {last.text} s")
