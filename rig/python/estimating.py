"""Run an estimator on stored or live frames, and score its angles against ground truth."""

import logging
import math
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from drivers import arguments
from drivers.clock import NS_PER_S
from drivers.errors import EstimatorError, InputError, plural
from drivers.formats import MAX_TIME_S
from drivers.realtime import compute_in_one_thread
from drivers.types import Image
from drivers.values import short_repr
from rig.frames.estimates import apply_zero, estimate_checked, require_frames_suffice
from rig.frames.series import FrameSeries, TimedFrame, evenly_spread, find_background
from rig.frames.streaming import StreamingEstimator, checked_sign
from rig.frames.times import LEAST_FPS, MAX_FPS, FrameTime, check_times, spacing_notes
from rig.results.metrics import summarize
from rig.results.scores import AXIS_DEG, TURN_DEG, unwrap
from rig.sessions.records import ErrorSummary
from rig.tactile.angles import Angles
from rig.tactile.estimators import ASPECTS, MAX_WINDOW, choose_estimator
from rig.tactile.foreign import ForeignEstimator
from rig.tactile.paper.estimator import WindowMean
from rig.tactile.sample import FROZEN, State, TactileEstimator, check_frame, faults_of

RATE_HZ = 60.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of angles compared with ground truth.

    mean_deg, std_deg, max_deg: of the absolute error over frames with an angle and ground truth; NaN without
    such frames. frames: number of these frames. answered: fraction of the frames with ground truth that have
    an angle. within_two_sigma: fraction of the angles with a sigma whose error is at most two sigma; NaN
    without such angles.
    """

    mean_deg: float
    std_deg: float
    max_deg: float
    frames: int
    answered: float
    within_two_sigma: float

    __repr__ = short_repr


def estimate(
    frames: Iterable[Image],
    background: Image | None = None,
    *,
    times_s: ArrayLike | None = None,
    fps: float = RATE_HZ,
    estimator: str | type[TactileEstimator] = "slip",
    window: int | None = None,
    pixel_aspect: float | None = None,
    gel: str | Path | None = None,
) -> Angles:
    """Estimate the rotation of the contact in tactile frames.

    frames: (H, W, 3) uint8 RGB, in order. background: a frame without contact; by default the mean of the
    first frames if they are alike and later ones differ, otherwise of the most frequent image. times_s: (N,)
    capture times; by default frames are `fps` per second. estimator: a name (`rig estimators` lists them),
    "package.module:Class", or a class of your own. window: mean of the last n angles; the default depends on
    the estimator. pixel_aspect: width of a pixel on the gel divided by its height, if known. gel: YAML file
    of `rig calibrate tactile`, from whose look `slip` computes slopes.

    Returns image angles as `rig estimate` does: counter-clockwise positive, relative to the first frame in
    which the contact has settled. Raises `InputError` for invalid frames or times, or if no background is
    given and no frames without contact are found; `EstimatorError` if the estimator cannot be made, or a
    class of your own fails on a frame. Warns (`UserWarning`) if the background looks like a contact
    or does not fit the frames, or the camera had frozen; doubtful times are logged.
    """
    if isinstance(frames, (str, Path)):
        raise InputError(
            f"estimate: {frames} is a path: give frames as arrays, or read files with rig estimate {frames}"
        )
    try:
        iter(frames)
    except TypeError:
        raise arguments.refusal("estimate: frames", frames, "images in order") from None
    fps = arguments.number("estimate: fps", fps, LEAST_FPS, MAX_FPS)
    seconds, notes = None, ()
    if times_s is not None:
        seconds = arguments.array("estimate: times_s", times_s, (None,), MAX_TIME_S)
        given_ns = np.rint(seconds * NS_PER_S).astype(np.int64)
        used_ns, notes = check_times("estimate: times_s", given_ns)
        seconds = np.where(used_ns == given_ns, seconds, used_ns / NS_PER_S)
    if background is None:
        frames = list(frames)
        if not frames:
            raise InputError("estimate: there are no frames")
        for image in frames:
            check_frame(image, getattr(frames[0], "shape", None))
        background, _ = find_background("estimate", frames, evenly_spread(frames))
    check_frame(background)
    series = FrameSeries("frames", lambda: _add_times(frames, seconds, fps))
    made = _make_estimator("estimate", estimator, background, window, pixel_aspect, 1, gel)
    found, check = estimate_checked(series, made, background)
    if not found.samples:
        raise InputError("estimate: there are no frames")
    if faults := faults_of(found.samples):
        raise EstimatorError(str(faults))
    if check.doubt:
        warnings.warn(f"{check.doubt}: give a frame without contact as background", stacklevel=2)
    if frozen := sum(sample.state is State.FROZEN for sample in found.samples):
        warnings.warn(f"{plural(frozen, 'frame')}: {FROZEN}", stacklevel=2)
    for text in (*notes, *spacing_notes([time.time_ns for time in found.times])):
        _log.warning("estimate: %s", text)
    return apply_zero(found, None).angles


def estimator(
    name: str | type[TactileEstimator] = "slip",
    *,
    background: Image,
    window: int | None = None,
    pixel_aspect: float | None = None,
    sign: int = 1,
    gel: str | Path | None = None,
) -> StreamingEstimator:
    """Make an estimator for the live frames of one sensor, the same that the rig runs during a lift.

    name, window, pixel_aspect, gel: as for `estimate`. background: a frame without contact, (H, W, 3) uint8
    RGB, preferably the mean of several. sign: -1 for a fingertip on the side of the object away from the
    camera. Raises `InputError`, and `EstimatorError` if it cannot be made. Warns (`UserWarning`) if the
    background looks like a contact, also later, after a frame that shows this.

    From then on OpenCV and BLAS compute in one thread in this program, as on the command line. Otherwise the
    last digits of the angles would depend on the number of cores.
    """
    check_frame(background)
    compute_in_one_thread()
    background = background.copy()
    sign = checked_sign("estimator: sign", sign)
    made = _make_estimator("estimator", name, background, window, pixel_aspect, sign, gel)
    stream = StreamingEstimator(made, background.shape, sign)
    stream.check_background(background)
    return stream


def score(estimate: Angles, truth: Angles) -> Score:
    """Compare angles with ground truth, which is interpolated at their times over gaps of at most 50 ms.

    A true angle with steps of more than 90 degrees is unwrapped, with a warning in the log. Steps that an
    object can turn in the time between two samples, at 200 deg/s, are kept, with another warning. A third one
    is that less than half of the frames have ground truth.
    """
    for name, angles in (("estimate", estimate), ("truth", truth)):
        arguments.instance(f"score: {name}", angles, Angles, "a rig.Angles")
    true, notes = unwrap("the true angle", truth, AXIS_DEG)
    ours, more = unwrap("the estimate", estimate, TURN_DEG)
    for note in (*notes, *more):
        _log.warning("score: %s", note)
    known = true.at(estimate.time_s)
    off = np.abs(ours.angle_deg - known)
    there, both = np.isfinite(known), np.isfinite(off)
    if 2 * there.sum() < there.size:
        _log.warning(
            "score: %d of %d frames have ground truth: are both times in s and from one zero, and is the "
            "truth sampled at least every 50 ms?", there.sum(), there.size,
        )  # fmt: skip
    errors = summarize(off[both]) or ErrorSummary(math.nan, math.nan, math.nan, 0)
    sure = both & np.isfinite(estimate.sigma_deg)
    within = float(np.mean(off[sure] <= 2 * estimate.sigma_deg[sure])) if sure.any() else math.nan
    answered = float(np.mean(both[there])) if there.any() else math.nan
    return Score(errors.mean_deg, errors.std_deg, errors.max_deg, errors.frames, answered, within)


def _make_estimator(
    where: str,
    estimator: str | type[TactileEstimator],
    background: Image,
    window: int | None,
    aspect: float | None,
    sign: int,
    gel: str | Path | None,
) -> TactileEstimator:
    """Validate the arguments of an estimator and make it. where: the function they were given to."""
    if window is not None:
        window = arguments.whole(f"{where}: window", window, 1, MAX_WINDOW)
    if aspect is not None:
        aspect = arguments.number(f"{where}: pixel_aspect", aspect, *ASPECTS)
    look = None if gel is None else arguments.path(f"{where}: gel", gel)
    if isinstance(estimator, str):
        choice = choose_estimator(estimator, window, gel=look)
        require_frames_suffice(choice)
        return choice.make(background, aspect, sign)
    if not isinstance(estimator, type):
        raise InputError(f"the estimator is a {type(estimator).__name__}: give a name or a class")
    choice = choose_estimator(None, window)
    made = ForeignEstimator(estimator.__name__, background, aspect, sign, estimator)
    return WindowMean(made, choice.window) if choice.window > 1 else made


def _add_times(frames: Iterable[Image], seconds: np.ndarray | None, fps: float) -> Iterator[TimedFrame]:
    """Yield the frames with their times; each is read only when needed, so they need not fit into memory."""
    number = -1
    for number, image in enumerate(frames):
        if seconds is not None and number >= len(seconds):
            raise InputError(f"estimate: {len(seconds)} times for more frames: give one time per frame")
        time_s = number / fps if seconds is None else float(seconds[number])
        time = FrameTime(f"{time_s:.9f}", round(time_s * NS_PER_S))
        frame = np.array(image)  # a copy: the caller may read the next frame into the same array
        check_frame(frame)
        yield TimedFrame(f"frame {number}", time, frame)
    if seconds is not None and number + 1 < len(seconds):
        raise InputError(f"estimate: {len(seconds)} times for {number + 1} frames: give one time per frame")
