"""Tactile frames of a lift as small pictures, with the contact and both angles drawn in.

Gaps of a recording are passed over: `rig.report.session` names them, once for each lift.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.images import encode_jpeg
from drivers.types import Frame, Image
from rig.pages.palette import ESTIMATE, TRUTH
from rig.report.curves import Curve, LiftCurves, truth_at
from rig.report.text import angle_text
from rig.results.metrics import Floats
from rig.sessions.reading import recorded_frames
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.paper.axis import ellipse_axis

FRAMES = 6
JPEG_QUALITY = 85
CAMERA_LONG_SIDE_PX = 320
_WHITE = (255, 255, 255)
_ARM_SHARE = 0.30
"""Half length of the drawn axes, as a share of the frame's height."""


@dataclass(frozen=True, slots=True)
class Still:
    """One picture of a strip: JPEG bytes, what it shows, and its width and height in px."""

    jpeg: bytes
    caption: str
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class TipFrames:
    """What is needed to draw into a fingertip's frames.

    finder: knows the frame without contact. axis_deg: of the contact at the zero, image angle, None
    where there was no contact to take it from. sign: turns the object's angle into the image's.
    """

    serial: str
    sign: int
    finder: ContactFinder
    axis_deg: float | None
    frames: tuple[Frame, ...] = ()


def strip(path: Path, lift: LiftCurves, zero_ns: int, serial: str, sign: int) -> list[Still]:
    """Draw a fingertip's frames over a lift: at the zero, through the slip, at the end.

    zero_ns: start of phase B by the recording's clock. Raises `SessionError` for a recording
    without this fingertip's frames.
    """
    wanted_ns = [zero_ns + round(t * NS_PER_S) for t in moments(lift)]
    tip = read_tip(path, lift, zero_ns, serial, sign, wanted_ns)
    stills = []
    for frame in tip.frames:
        time_s = (frame.time_ns - zero_ns) / NS_PER_S
        estimate, truth = angles_at(lift, serial, time_s)
        picture = drawn(frame.image, tip, estimate, truth)
        stills.append(still(picture, caption(time_s, estimate, truth)))
    return stills


def camera_strip(path: Path, lift: LiftCurves, zero_ns: int, serial: str) -> list[Still]:
    """The camera's pictures at the same moments, smaller. Raises `SessionError` where there are none."""
    frames = list(recorded_frames(path, serial, gaps=[]))
    if not frames:
        raise SessionError(f"{path}: holds no pictures of the camera {serial}")
    stills = []
    for time_s in moments(lift):
        frame = _nearest(frames, zero_ns + round(time_s * NS_PER_S))
        seen_s = (frame.time_ns - zero_ns) / NS_PER_S
        scale = min(1.0, CAMERA_LONG_SIDE_PX / max(frame.image.shape[:2]))
        small = cv2.resize(frame.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        truth = float(truth_at(lift.truth, np.array([seen_s]))[0])
        stills.append(
            still(np.asarray(small, np.uint8), f"{round(seen_s, 2) + 0.0:.2f} s: {angle_text(truth)}")
        )
    return stills


def still(picture: Image, text: str) -> Still:
    """Pack a picture, (H, W, 3) uint8 RGB, with what it shows."""
    height, width = picture.shape[:2]
    return Still(encode_jpeg(picture, JPEG_QUALITY), text, (width, height))


def moments(lift: LiftCurves, count: int = FRAMES) -> list[float]:
    """Times worth a picture, s: the zero, the turn in equal steps, and the end of C."""
    start, end = lift.phases_s.get("B", 0.0), lift.phases_s.get("lower", 0.0)
    onset = lift.onset_truth_s if lift.onset_truth_s is not None else start
    turned = lift.truth.answered
    settled = end
    if turned.time_s.size:
        final = turned.angle_deg[-1]
        late = turned.time_s[np.abs(turned.angle_deg - final) < 0.05 * max(abs(final), 1.0)]
        settled = float(late[late > onset].min(initial=end))
    return [start, *np.linspace(onset, settled, count - 1)[1:].tolist(), max(end - 0.05, start)]


def read_tip(
    path: Path, lift: LiftCurves, zero_ns: int, serial: str, sign: int, wanted_ns: list[int] | None = None
) -> TipFrames:
    """Read a fingertip's frames: those nearest to the wanted times, or all from phase A on."""
    grasp_ns = zero_ns + round(lift.phases_s.get("A", 0.0) * NS_PER_S)
    frames = list(recorded_frames(path, serial, gaps=[]))
    reference = [f.image for f in frames if f.time_ns < grasp_ns]
    frames = [f for f in frames if f.time_ns >= grasp_ns]
    if not reference or not frames:
        raise SessionError(f"{path}: holds no frames of {serial} before and after the grasp")
    finder = ContactFinder(mean_background(reference))
    chosen = frames if wanted_ns is None else [_nearest(frames, t) for t in wanted_ns]
    return replace(tip_at_zero(serial, sign, finder, _nearest(frames, zero_ns).image), frames=tuple(chosen))


def tip_at_zero(serial: str, sign: int, finder: ContactFinder, zero: Image | None) -> TipFrames:
    """Return what is drawn into frames. zero: frame at the zero, (H, W, 3) uint8 RGB, or None."""
    contact = None if zero is None else finder.find(zero)
    axis = None if contact is None or contact.mask is None else ellipse_axis(contact.contour)
    return TipFrames(serial, sign, finder, None if axis is None else axis.angle_deg)


def drawn(image: Image, tip: TipFrames, estimate_deg: float, truth_deg: float) -> Image:
    """Draw contact and axes into a copy of a frame, (H, W, 3) uint8 RGB; NaN angles are left out."""
    picture = image.copy()
    contact = tip.finder.find(image)
    if contact.mask is None:
        return picture
    cv2.polylines(picture, [np.rint(contact.contour).astype(np.int32)], True, _WHITE, 1, cv2.LINE_AA)
    if tip.axis_deg is not None:
        for angle, colour, thick in ((truth_deg, TRUTH.light, 5), (estimate_deg, ESTIMATE.dark, 2)):
            if math.isfinite(angle):
                _axis(picture, contact, tip.axis_deg + tip.sign * angle, rgb(colour), thick)
    return picture


def angles_at(lift: LiftCurves, serial: str, time_s: float) -> tuple[float, float]:
    """A fingertip's angle and the markers' nearest to a time, deg, NaN where unknown."""
    truth = truth_at(lift.truth, np.array([time_s]))[0]
    return _value_at(lift.tips.get(serial, lift.estimate), time_s), float(truth)


def caption(time_s: float, estimate_deg: float, truth_deg: float | None = None) -> str:
    """Say when, and both angles. truth_deg: None if there is no ground truth at all."""
    marker = "" if truth_deg is None else f", marker {angle_text(truth_deg)}"
    return f"{round(time_s, 2) + 0.0:.2f} s: {angle_text(estimate_deg)}{marker}"


def rgb(hex_colour: str) -> tuple[int, int, int]:
    """A colour as OpenCV takes it for RGB pictures."""
    red, green, blue = (int(hex_colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def _axis(
    picture: Image, contact: Contact, angle_deg: float, colour: tuple[int, int, int], thick: int
) -> None:
    middle: NDArray[np.float32] = contact.contour.reshape(-1, 2).mean(axis=0)
    # image angles: counter-clockwise as seen, y down
    turn = math.radians(angle_deg)
    arm = _ARM_SHARE * picture.shape[0] * np.array([math.cos(turn), -math.sin(turn)])
    ends = [tuple(np.rint(middle + side * arm).astype(int).tolist()) for side in (-1, 1)]
    cv2.line(picture, ends[0], ends[1], colour, thick, cv2.LINE_AA)


def _nearest(frames: list[Frame], time_ns: int) -> Frame:
    return min(frames, key=lambda f: abs(f.time_ns - time_ns))


def _value_at(curve: Curve, time_s: float) -> float:
    times: Floats = curve.time_s
    return float(curve.angle_deg[int(np.abs(times - time_s).argmin())]) if times.size else math.nan
