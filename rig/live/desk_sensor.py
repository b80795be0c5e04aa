"""One sensor on a desk, frame by frame: its background, estimator, reference and clip."""

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import InputError, counted
from drivers.tally import FrameTally
from drivers.types import Frame, Image
from rig.frames.streaming import AngleSample, StreamingEstimator
from rig.live.clip_writer import ClipWriter
from rig.live.sensor_background import SensorBackground
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import State, check_frame

OUTLINE_EVERY_S = 0.05
OUTLINE_STEP = 4
"""The points of an outline are 1 px apart; every 4th point is shown."""
TAKING_BACKGROUND = "taking the background"
"""State while the background is taken."""
RATE_FRAMES = 61
"""Number of frames for the computation of the frame rate: one second of a DIGIT."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The result for one frame of a sensor, or the fused angle of the object.

    sample: None while the background is taken. fps: frame rate from capture times, None at first. latency_s:
    time from capture to the angle. dropped: number of lost or skipped frames. zero_s: time of the frame whose
    angle is 0, None without a reference. background: its origin. doubt: why the background is doubtful, else
    empty. outline: of the contact, (N, 2) px, x right and y down. frame: None for the object. slips_s:
    capture times at which the slip alarm was raised, s.
    """

    name: str
    time_ns: int
    state: str
    sample: AngleSample | None = None
    fps: float | None = None
    latency_s: float = 0.0
    dropped: int = 0
    zero_s: float | None = None
    background: str = ""
    doubt: str = ""
    outline: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 2), np.float32))
    frame: Frame | None = None
    slips_s: tuple[float, ...] = ()

    def values(self) -> dict[str, object]:
        """Return the reading as JSON values."""
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
    """One sensor: its background, estimator and clip.

    sign: factor from the image angle to the object angle. background: None to take it from the first frames.
    aspect: width over height of a pixel on the gel, if known. serial: under which its background is stored;
    None for a source without a serial.
    """

    def __init__(
        self,
        name: str,
        choice: EstimatorChoice,
        sign: int,
        background: Image | None,
        aspect: float | None,
        serial: str | None = None,
    ) -> None:
        self.name = name
        self.stream: StreamingEstimator | None = None
        self.clip: ClipWriter | None = None
        self.background = SensorBackground(background, serial)
        self.news = ""
        """News about the background, or that the sensor has frozen, in the newest frame, for the user."""
        self.slip = False
        """Whether the slip alarm was on at the newest frame."""
        self._choice, self._sign, self._aspect = choice, sign, aspect
        self._tally, self._times = FrameTally(), deque[int](maxlen=RATE_FRAMES)
        self._states: Counter[str] = Counter()
        self._answered = 0
        self._finder: ContactFinder | None = None
        self._outline = np.empty((0, 2), np.float32)
        self._outlined_ns = 0

    @property
    def summary(self) -> str:
        """The number of frames, of those with an angle, and of those without by their state."""
        states = ", ".join(f"{count} {state}" for state, count in sorted(self._states.items()))
        without = states.replace("_", " ") or "none"
        return (
            f"{self._answered} of {counted(self._tally.frames, 'frame')} with an angle; "
            f"without: {without}; {self.dropped} dropped"
        )

    @property
    def dropped(self) -> int:
        """Number of lost or skipped frames."""
        return self._tally.dropped

    def take(self, frame: Frame, clock: Clock) -> Reading:
        """Estimate the angle in a frame. Raises `InputError`."""
        self._tally.add(frame)
        self._times.append(frame.time_ns)
        sample, state = None, TAKING_BACKGROUND
        if not self.background.collecting:
            sample = self._estimated(frame)
            state, self.slip = sample.state, sample.slip
        self.news = self.background.add(frame) or (self.stream.news if self.stream is not None else "")
        self._count(sample, state)
        late_s = (clock.now_ns() - frame.time_ns) / NS_PER_S
        span_s = (self._times[-1] - self._times[0]) / NS_PER_S
        fps = (len(self._times) - 1) / span_s if span_s > 0 else None
        slips_s = () if self.stream is None else self.stream.slips_s
        return Reading(
            self.name,
            frame.time_ns,
            state,
            sample,
            fps,
            late_s,
            self.dropped,
            self._zero_s,
            self.background.origin,
            self.background.doubt,
            self._outline,
            frame,
            slips_s,
        )

    def made(self, choice: EstimatorChoice) -> StreamingEstimator | None:
        """Make an estimator for this sensor, to `choose` it; return None while the background is taken.

        Raises `EstimatorError` or `InputError` if it cannot be made.
        """
        background = self.background.image
        if background is None or self.background.collecting:
            choice.try_making()
            return None
        return self._made(choice, background)

    def choose(self, choice: EstimatorChoice, stream: StreamingEstimator | None) -> None:
        """Change the estimator; the reference is set again when the contact has settled.

        stream: from `made`.
        """
        self._choice, self.stream = choice, stream

    def take_background(self) -> None:
        """Take the background from the next frames."""
        self.background.take()
        self.stream = self._finder = None
        self._outline = self._outline[:0]

    def set_reference(self) -> None:
        """Set the reference now. Raises `InputError` without a contact."""
        if self.stream is None:
            raise InputError("reference: wait until the background is taken")
        self.stream.set_reference()

    @property
    def _zero_s(self) -> float | None:
        zero = None if self.stream is None else self.stream.track.zero_sample
        return None if zero is None else zero.time_ns / NS_PER_S

    def _count(self, sample: AngleSample | None, state: str) -> None:
        if sample is None or sample.angle_deg is None:
            self._states[state] += 1
        else:
            self._answered += 1

    def _estimated(self, frame: Frame) -> AngleSample:
        background = frame.image if self.background.image is None else self.background.image
        if self._finder is None:
            check_frame(frame.image, background.shape)
            self._finder = ContactFinder(background)
        self.stream = self.stream or self._made(self._choice, background)
        self.stream.misfit = self.background.misfit
        sample = self.stream.update_at(frame.image, frame.time_ns)
        self._find_outline(frame, sample, self._finder)
        return sample

    def _made(self, choice: EstimatorChoice, background: Image) -> StreamingEstimator:
        estimator = choice.make(background, self._aspect, self._sign)
        return StreamingEstimator(estimator, background.shape, self._sign, each_contact=True)

    def _find_outline(self, frame: Frame, sample: AngleSample, finder: ContactFinder) -> None:
        if sample.state == State.NO_CONTACT:
            self._outline = self._outline[:0]
        elif frame.time_ns - self._outlined_ns >= to_ns(OUTLINE_EVERY_S):
            self._outlined_ns = frame.time_ns
            self._outline = finder.find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]
