"""Times per frame as users get them, beside a reference on the same frames and the same computer."""

from collections.abc import Callable, Iterable
from itertools import count
from time import perf_counter

import cv2
import numpy as np

from drivers.clock import SystemClock
from drivers.types import ArmState, Frame, Image
from rig.frames.estimates import estimate_frames
from rig.frames.streaming import StreamingEstimator
from rig.live.desk_sensor import DeskSensor
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import SlipSample, State, TactileEstimator, TimedImage

REFERENCE, ITERATIONS = "cv2.findTransformECC", 5
"""OpenCV's alignment, with which times are compared, and its fixed number of iterations. It takes about as
long as an estimator, for any content of the frames."""
TIMES_REFERENCE = f"times {REFERENCE}"
"""Heading of a column with the values of `times_reference`."""
AS_MULTIPLE = (
    f"median time as a multiple of that of {REFERENCE} on the same frames: rotation and shift to the frame "
    f"before, grey, {ITERATIONS} iterations"
)
ALONE, PYTHON, LIVE = "the estimator alone", "rig.estimator", "rig live"


class Streamed(TactileEstimator):
    """An estimator behind the interface of `rig.estimator`, with all checks of a stream.

    background: (H, W, 3) uint8 RGB, with which the estimator was made.
    """

    def __init__(self, estimator: TactileEstimator, background: Image) -> None:
        self._estimator = estimator
        self._stream = StreamingEstimator(estimator, background.shape)
        self._stream.check_background(background)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB; the image is copied, as by `rig.estimator`."""
        return self._stream.update_at(image.copy(), time_ns)

    def arm(self, state: ArmState) -> None:
        """Pass the state of the arm on."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Notify the estimator that the fingers have closed further."""
        self._estimator.gripped_further()


class Reference(TactileEstimator):
    """Aligns each frame with the frame before by `REFERENCE`; only its run time is used."""

    def __init__(self) -> None:
        self._before: Image | None = None

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Align a frame, (H, W, 3) uint8 RGB."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        before, self._before = grey if self._before is None else self._before, grey
        stop = (cv2.TERM_CRITERIA_COUNT, ITERATIONS, -1.0)
        try:
            cv2.findTransformECC(before, grey, np.eye(2, 3, dtype=np.float32), cv2.MOTION_EUCLIDEAN, stop)
        except cv2.error:  # frames of one colour
            return SlipSample(time_ns, State.LOST)
        return SlipSample(time_ns, State.TRACKING)


def reference_ms(frames: Iterable[TimedImage]) -> list[float]:
    """Return the time of `REFERENCE` for each readable frame, ms."""
    return [1e3 * of.cost_s for of in estimate_frames(Reference(), frames) if of.cost_s is not None]


def times_reference(contact_ms: Iterable[float], reference_ms: Iterable[float]) -> float | None:
    """Return the median of times per frame as a multiple of that of the reference; None without times."""
    ours, theirs = list(contact_ms), list(reference_ms)
    return float(np.median(ours) / np.median(theirs)) if ours and theirs else None


def interface_ms(
    choice: EstimatorChoice, background: Image, frames: Iterable[TimedImage]
) -> dict[str, list[float]]:
    """Return the times of the frames with contact, ms, by the interface through which they are estimated.

    All interfaces estimate a frame before the next one, in an order that rotates. The time of `rig live`
    includes its outline of the contact, but not the picture that it sends to the page.
    """
    desk, clock, numbers = DeskSensor("", choice, 1, background, None), SystemClock(), count()
    desk.choose(choice, desk.make_stream(choice))  # before the first frame

    def live(image: Image, time_ns: int) -> SlipSample | None:
        return desk.take(Frame(image, time_ns, next(numbers), ""), clock).sample

    updates: dict[str, Callable[[Image, int], SlipSample | None]] = {
        ALONE: choice.make(background).update,
        PYTHON: Streamed(choice.make(background), background).update,
        LIVE: live,
    }
    names = list(updates)
    spent: dict[str, list[float]] = {name: [] for name in names}
    for frame in frames:
        if frame.image is None:
            continue
        names.append(names.pop(0))
        for name in names:
            began = perf_counter()
            sample = updates[name](frame.image, frame.time_ns)
            spent_ms = 1e3 * (perf_counter() - began)
            spent[name].extend([spent_ms] if sample is not None and sample.estimated else [])
    return spent
