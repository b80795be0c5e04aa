"""The no-contact reference of a tactile sensor, and the drift of light and gel since an earlier one."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.verdict import Assessment, limits
from drivers.errors import CalibrationError, plural
from drivers.types import Image

Array = NDArray[np.floating]

FEWEST_FRAMES = 5
SATURATED = 250
"""Grey level from which a value counts as saturated."""
_CONTACT_SIGMAS = 8.0
_LEAST_CHANGE_GREY = 6.0
_HOT_GREY = 40.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The picture of an untouched sensor.

    image: (H, W, 3) float32 RGB, the mean of its frames. noise_grey: one sigma of a value in one
    frame. saturated: share of saturated values. hot_pixels: isolated pixels that stand out.
    """

    image: NDArray[np.float32]
    noise_grey: float
    saturated: float
    hot_pixels: int


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """How a sensor changed since an earlier reference.

    gain: (3,) brightness of R, G, B relative to the earlier reference. contact_share: share of the
    picture that changed by more than the light explains. moved_px: (x, y) shift of the picture, px.
    """

    gain: Array
    contact_share: float
    moved_px: tuple[float, float]


def make_reference(frames: Sequence[Image]) -> Reference:
    """Average frames of one untouched sensor, (H, W, 3) uint8 RGB each.

    Raises `CalibrationError` for too few frames, for frames that differ in size or content, and for a
    picture that is dark or uniform.
    """
    if len(frames) < FEWEST_FRAMES:
        raise CalibrationError(
            f"tactile reference: {plural(len(frames), 'frame')}; at least {FEWEST_FRAMES} are needed"
        )
    check_light(frames[0], "tactile reference")
    if any(frame.shape != frames[0].shape or frame.dtype != np.uint8 for frame in frames):
        raise CalibrationError("tactile reference: its frames differ in size or type; is it one sensor?")
    stack = np.stack(frames).astype(np.float32)
    image = stack.mean(axis=0)
    noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean()))
    half = len(frames) // 2
    change = changed_share(stack[:half].mean(axis=0), stack[half:].mean(axis=0), noise / np.sqrt(half))
    if change > 0.01:
        raise CalibrationError(
            f"tactile reference: {change:.0%} of the picture changed while it was taken; "
            "nothing may touch the gel"
        )
    grey = image.max(axis=2)
    hot_pixels = int((np.abs(grey - cv2.medianBlur(grey, 3)) > _HOT_GREY).sum())
    return Reference(image, noise, float((image >= SATURATED).mean()), hot_pixels)


def check_light(frame: Image, name: str) -> None:
    """Raise `CalibrationError` unless (H, W, 3) uint8 and neither dark nor uniform."""
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8 or frame.size == 0:
        raise CalibrationError(f"{name}: (H, W, 3) uint8 RGB is needed, got {frame.shape} {frame.dtype}")
    if float(frame.std()) < 1.0:
        raise CalibrationError(
            f"{name}: every pixel is alike ({frame.mean():.0f} grey); is the sensor connected?"
        )
    if float(frame.mean()) < 8.0:
        raise CalibrationError(f"{name}: almost dark (mean {frame.mean():.1f} grey); are the LEDs on?")


def drift_since(reference: Reference, earlier: NDArray[np.float32]) -> Drift:
    """Measure what changed since an earlier reference. Raises `CalibrationError` for another size."""
    if reference.image.shape != earlier.shape:
        raise CalibrationError(
            f"tactile reference: size {reference.image.shape[:2]} is not the earlier {earlier.shape[:2]}"
        )
    lit = earlier > 10.0
    gain = np.array([np.median(reference.image[..., c][lit[..., c]] / earlier[..., c][lit[..., c]])
                     if lit[..., c].any() else np.nan for c in range(3)])  # fmt: skip
    expected = earlier * np.nan_to_num(gain, nan=1.0)
    share = changed_share(expected.astype(np.float32), reference.image, reference.noise_grey)
    (dx, dy), _ = cv2.phaseCorrelate(_detail(earlier), _detail(reference.image))
    return Drift(gain, share, (float(dx), float(dy)))


def assess_reference(reference: Reference, drift: Drift | None = None) -> Assessment:
    assessment = limits(
        (100 * reference.saturated, 1.0, 30.0, "{value:.0f} % of the values are saturated: dim the LEDs"),
        (reference.noise_grey, 5.0, 25.0, "frames scatter by {value:.1f} grey: is the light flickering?"),
        (reference.hot_pixels, 20, np.inf, "{value} hot pixels"),
        (float(reference.image.mean()), 25.0, 8.0, "the picture is dark (mean {value:.0f} grey)",
         "mean brightness: {value:.0f} grey"),
    )  # fmt: skip
    if drift is None:
        return assessment + Assessment(
            doubts=("no earlier reference to compare with: a contact during it would not be detected",)
        )
    if not np.isfinite(drift.gain).all() or float(np.min(drift.gain)) < 0.3:
        return assessment + Assessment(
            (f"an LED went out (R, G, B gains {np.round(drift.gain, 2).tolist()})",)
        )
    worst = float(np.abs(np.log(drift.gain)).max())
    return assessment + limits(
        (100 * worst, 10.0, 60.0, "the light changed by {value:.0f} % since the earlier reference"),
        (100 * drift.contact_share, 1.0, 5.0,
         "{value:.0f} % of the picture changed shape: contact in it, a damaged gel, or another sensor"),
        (float(np.hypot(*drift.moved_px)), 1.0, 8.0, "the picture moved by {value:.1f} px"),
    )  # fmt: skip


def changed_share(one: NDArray[np.float32], other: NDArray[np.float32], noise_grey: float) -> float:
    """Share of the picture where two smoothed pictures differ beyond noise."""
    smooth = cv2.GaussianBlur(np.asarray(other - one, np.float32), (0, 0), 3.0)
    bound = max(_CONTACT_SIGMAS * noise_grey / 10.0, _LEAST_CHANGE_GREY)
    return float((np.abs(smooth).max(axis=2) > bound).mean())


def _detail(image: NDArray[np.float32]) -> NDArray[np.float32]:
    grey = np.asarray(image.mean(axis=2), np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.5) - cv2.GaussianBlur(grey, (0, 0), 8.0), np.float32)
