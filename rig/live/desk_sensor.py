"""One sensor on a desk: the thread that waits for its frames, its background, its estimator, its readings.

`rig live`, `rig bridge` and `rig.python.fingertip` use them in the same way.
"""

import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, StaleFrameError, plural
from drivers.interfaces import FrameSource
from drivers.tally import FrameTally
from drivers.types import Frame, Image
from rig.frames.streaming import StreamingEstimator
from rig.live.feed import NO_FRAMES
from rig.live.sensor_background import PRESS_BUTTON, SensorBackground
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import SlipSample, State, check_frame

LATEST_S = 0.3
"""Frames that wait longer are skipped and counted as dropped, so that the angle is never late."""
FRAME_TIMEOUT_S = 1.0
"""Time without a frame after which a sensor is reported, unless two of its frames take longer."""
OUTLINE_EVERY_S = 0.05
OUTLINE_STEP = 4
"""The points of an outline are 1 px apart; every 4th point is shown."""
NO_OUTLINE = np.empty((0, 2), np.float32)
TAKING_BACKGROUND = "taking the background"
"""State while the background is taken."""
PREPARING = "preparing the estimator"
"""State after that, while the loops of the estimator are compiled."""
WITH_ANGLE = "with an angle"
"""Key under which frames with an angle are counted, beside the states of those without."""
RATE_FRAMES = 61
"""Number of frames for the computation of the frame rate: one second of a DIGIT."""


class Streams:
    """The frames of sources in the order of their arrival. One thread per source waits for its frames.

    sources: connected before `start`; `close` disconnects them.
    """

    def __init__(self, sources: Sequence[FrameSource], clock: Clock) -> None:
        self._sources, self._clock = sources, clock
        self._frames: queue.Queue[tuple[str, Frame | DeviceError]] = queue.Queue(maxsize=len(sources))
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=self._wait, args=(s,), daemon=True) for s in sources]
        self._open = len(sources)

    @property
    def has_ended(self) -> bool:
        """Whether each source has ended, and its last frame has been returned."""
        return self._open == 0

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Disconnect the sources and end the threads."""
        self._stopping.set()
        for source in self._sources:
            source.disconnect()
        for thread in self._threads:
            while thread.is_alive():
                with suppress(queue.Empty):
                    self._frames.get_nowait()
                thread.join(0.01)

    def next(self, timeout_s: float) -> tuple[str, Frame | DeviceError] | None:
        """Return the next frame of any source with its serial; None if none arrives in time.

        If a source has sent no frame for `FRAME_TIMEOUT_S`, a `DeviceTimeoutError` takes the place of the
        frame. Any other error is the last one of its source.
        """
        try:
            serial, frame = self._frames.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if isinstance(frame, DeviceError) and not isinstance(frame, DeviceTimeoutError):
            self._open -= 1
        return serial, frame

    def _wait(self, source: FrameSource) -> None:
        """Pass on a source's frames until it ends or the streams are closed; runs in a separate thread."""
        timeout_s = max(FRAME_TIMEOUT_S, 2.0 / source.rate_hz)
        while not self._stopping.is_set():
            try:
                frame = source.next_frame(timeout_s)
                if not source.waits and self._clock.now_ns() - frame.time_ns > to_ns(LATEST_S):
                    frame = source.newest_frame(timeout_s)
            except StaleFrameError:
                continue
            except DeviceError as error:
                self._frames.put((source.serial, error))
                if not isinstance(error, DeviceTimeoutError):  # after that the source is opened again
                    return
            else:
                self._frames.put((source.serial, frame))


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The result for one frame of a sensor, or the fused angle of the object.

    sample: None while the background is taken or the estimator is prepared, and if no frames arrive. fps:
    frame rate from capture times, None at first and if no frames arrive. latency_s: time from capture to the
    angle. dropped: number of lost or skipped frames. zero_s: time of the frame whose angle is 0, None until
    the contact has settled. background: its origin. doubt: why the background is doubtful, else empty.
    outline: of the contact, (N, 2) px, x right and y down. frame: None for the object, and if no frames
    arrive. slips_s: capture times at which the slip alarm was raised, s.
    """

    name: str
    time_ns: int
    state: str
    sample: SlipSample | None = None
    fps: float | None = None
    latency_s: float = 0.0
    dropped: int = 0
    zero_s: float | None = None
    background: str = ""
    doubt: str = ""
    outline: NDArray[np.float32] = field(default_factory=lambda: NO_OUTLINE)
    frame: Frame | None = None
    slips_s: tuple[float, ...] = ()

    def without_frames(self) -> "Reading":
        """Return the reading of a sensor from which no frames arrive after this one."""
        return replace(self, state=NO_FRAMES, sample=None, fps=None)

    def line(self) -> str:
        sample, angle = self.sample, "angle     -    "
        if sample is not None and sample.angle_deg is not None:
            sigma = "" if sample.sigma_deg is None else f" +- {sample.sigma_deg:.1f}"
            angle = f"angle {sample.angle_deg:+6.1f}{sigma} deg"
        rate = "" if sample is None or sample.rate_deg_s is None else f", {sample.rate_deg_s:+.1f} deg/s"
        slip = "  SLIP" if sample is not None and sample.slip else ""
        if self.slips_s and not slip:
            slip = f", last slip {self.time_ns / NS_PER_S - self.slips_s[-1]:.1f} s ago"
        fps = "-" if self.fps is None else f"{self.fps:.0f}"
        return (
            f"{self.name}: {angle}{rate}, {self.state}{slip}; {fps} frames/s, {self.dropped} dropped, "
            f"{1e3 * self.latency_s:.0f} ms"
        )

    def values(self) -> dict[str, object]:
        sample = self.sample
        return {
            "sensor": self.name,
            "t_s": self.time_ns / NS_PER_S,
            "state": self.state,
            "angle_deg": sample and sample.angle_deg,
            "sigma_deg": sample and sample.sigma_deg,
            "rate_deg_s": sample and sample.rate_deg_s,
            "slip": bool(sample and sample.slip),
            "slips_s": self.slips_s,
            "fps": None if self.fps is None else round(self.fps, 1),
            "latency_ms": round(1e3 * self.latency_s, 2),
            "dropped": self.dropped,
            "zero_s": self.zero_s,
            "background": self.background,
            "doubt": self.doubt,
        }


class DeskSensor:
    """One sensor: its background, its estimator, and the readings of its frames.

    sign: factor from the image angle to the object angle. background: None to take it from the first frames.
    aspect: width over height of a pixel on the gel, if known. serial: under which its background is stored;
    None for a source without a serial. remedy: see `SensorBackground`.
    """

    def __init__(
        self,
        name: str,
        choice: EstimatorChoice,
        sign: int,
        background: Image | None,
        aspect: float | None,
        serial: str | None = None,
        remedy: str = PRESS_BUTTON,
    ) -> None:
        self.name = name
        self.background = SensorBackground(background, serial, remedy)
        self.stream: StreamingEstimator | None = None
        self.reading: Reading | None = None
        """That of the newest frame; None if no frames arrive."""
        self.news = ""
        """News about the background, or that the sensor has frozen, in the newest frame, for the user."""
        self._choice, self._make = choice, partial(_make_stream, sign, aspect)
        self._is_prepared: Callable[[], bool] = lambda: True
        self._tally, self._times = FrameTally(), deque[int](maxlen=RATE_FRAMES)
        self._states: Counter[str] = Counter()
        self._outline: _Outline | None = None

    @property
    def summary(self) -> str:
        """The number of frames, of those with an angle, and of those without by their state."""
        counts = dict(sorted(self._states.items()))
        answered = counts.pop(WITH_ANGLE, 0)
        without = ", ".join(f"{count} {state}" for state, count in counts.items()).replace("_", " ")
        return (
            f"{answered} of {plural(self._tally.frames, 'frame')} with an angle; "
            f"without: {without or 'none'}; {self.dropped} dropped"
        )

    @property
    def dropped(self) -> int:
        return self._tally.dropped

    @property
    def slip(self) -> bool:
        """Whether the slip alarm is on at the newest frame; False if no frames arrive."""
        sample = None if self.reading is None else self.reading.sample
        return sample is not None and bool(sample.slip)

    @property
    def zero_s(self) -> float | None:
        """Capture time of the frame whose angle is 0, s; None until the contact has settled."""
        zero = self.stream.track.zero_sample if self.stream is not None and self.stream.settled else None
        return None if zero is None else zero.time_ns / NS_PER_S

    def take(self, frame: Frame, clock: Clock) -> Reading:
        """Estimate the angle in a frame. Raises `InputError`."""
        self._tally.add(frame)
        self._times.append(frame.time_ns)
        waiting = TAKING_BACKGROUND if self.background.image is None else PREPARING
        sample = self._estimate(frame)
        state = waiting if sample is None else sample.state.value
        self._states[state if sample is None or sample.angle_deg is None else WITH_ANGLE] += 1
        self.news = self.background.add(frame) or ("" if self.stream is None else self.stream.news)
        span_s = (self._times[-1] - self._times[0]) / NS_PER_S
        self.reading = Reading(
            self.name,
            frame.time_ns,
            state,
            sample,
            fps=(len(self._times) - 1) / span_s if span_s > 0 else None,
            latency_s=(clock.now_ns() - frame.time_ns) / NS_PER_S,
            dropped=self.dropped,
            zero_s=self.zero_s,
            background=self.background.origin,
            doubt=self.background.doubt,
            outline=NO_OUTLINE if self._outline is None else self._outline.points,
            frame=frame,
            slips_s=() if self.stream is None else self.stream.slips_s,
        )
        return self.reading

    def lose_frames(self) -> Reading | None:
        """Note that no frames arrive; return the reading for it, None if none arrived before either."""
        before, self.reading = self.reading, None
        return None if before is None else before.without_frames()

    def wait_until(self, is_prepared: Callable[[], bool]) -> None:
        """Make the estimator only when it is prepared; until then frames have the state `PREPARING`."""
        self._is_prepared = is_prepared

    def make_stream(self, choice: EstimatorChoice) -> StreamingEstimator | None:
        """Make an estimator for this sensor, to `choose` it; return None while the background is taken.

        Raises `EstimatorError` or `InputError` if it cannot be made.
        """
        if self.background.image is None:
            choice.try_making()
            return None
        return self._make(choice, self.background.image)

    def choose(self, choice: EstimatorChoice, stream: StreamingEstimator | None) -> None:
        """Change the estimator; the reference is set again when the contact has settled.

        stream: from `make_stream`.
        """
        self._choice, self.stream = choice, stream

    def take_background(self) -> None:
        self.background.take()
        self.stream = self._outline = None

    def set_reference(self) -> None:
        """Set the reference now. Raises `InputError` without a contact."""
        if self.stream is None:
            raise InputError("reference: wait until the background is taken")
        self.stream.set_reference()

    def _estimate(self, frame: Frame) -> SlipSample | None:
        background = self.background.image
        if background is None or (self.stream is None and not self._is_prepared()):
            return None
        if self._outline is None:
            check_frame(frame.image, background.shape)
            self._outline = _Outline(background)
        if self.stream is None:
            self.stream = self._make(self._choice, background)
        self.stream.misfit = self.background.misfit
        sample = self.stream.update_at(frame.image, frame.time_ns)
        self._outline.update(frame, sample.state)
        return sample


class _Outline:
    """The outline of a contact, at most once in `OUTLINE_EVERY_S`: (N, 2) px, x right and y down."""

    def __init__(self, background: Image) -> None:
        self.points: NDArray[np.float32] = NO_OUTLINE
        self._finder = ContactFinder(background)
        self._found_ns: int | None = None

    def update(self, frame: Frame, state: State) -> None:
        if state == State.NO_CONTACT:
            self.points = NO_OUTLINE
        elif self._found_ns is None or not 0 <= frame.time_ns - self._found_ns < to_ns(OUTLINE_EVERY_S):
            self._found_ns = frame.time_ns
            self.points = self._finder.find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]


def _make_stream(
    sign: int, aspect: float | None, choice: EstimatorChoice, background: Image
) -> StreamingEstimator:
    estimator = choice.make(background, aspect, sign)
    return StreamingEstimator(estimator, background.shape, sign, each_contact=True)
