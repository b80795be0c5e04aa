"""Small images of the tactile frames of a lift, with the contact and both angles drawn in.

Gaps of a recording are skipped; `rig.report.session` reports them once per lift.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.images import decode_stored, encode_jpeg
from drivers.types import Frame, Image
from rig.pages.palette import ESTIMATE, TRUTH
from rig.report.parts import angle_text
from rig.sessions.reading import recorded_frames, recorded_jpeg
from rig.sessions.recorder import image_topic
from rig.sessions.recording_file import recorded_messages
from rig.sessions.records import Lift
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.paper.axis import ellipse_axis

FRAMES = 6
SHORTEST_S = 0.2
"""Shortest rotation whose steps are shown; of a shorter one the whole lift is shown."""
BACKGROUND_FRAMES = 10
"""Number of frames before the grasp whose mean is the background of drawn outlines."""
JPEG_QUALITY = 85
LONG_SIDE_PX = 320
_WHITE = (255, 255, 255)
_ARM_SHARE = 0.30
"""Half length of the drawn axes, as a fraction of the frame's height."""


@dataclass(frozen=True, slots=True)
class Still:
    """One image of a strip: JPEG bytes, caption, and width and height in px."""

    jpeg: bytes
    caption: str
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class TipFrames:
    """Data for drawing into a fingertip's frames.

    finder: detects the contact. axis_deg: image angle of the contact at the zero, None without contact then.
    sign: factor from the object's angle to the image angle.
    """

    serial: str
    sign: int
    finder: ContactFinder
    axis_deg: float | None
    frames: tuple[Frame, ...] = ()


Stored = dict[str, list[tuple[int, bytes]]]
"""Times, ns, and messages of the images of a recording, by serial."""


def stored_images(path: Path, serials: Sequence[str]) -> Stored:
    """Read the images of some sources, without decoding them. Raises `SessionError`."""
    found: Stored = {image_topic(serial): [] for serial in serials}
    for topic, time_ns, _, data in recorded_messages(path, *found, gaps=[]):
        found[topic].append((time_ns, data))
    return dict(zip(serials, found.values(), strict=True))


def pictures(
    path: Path, stored: Stored, lift: Lift, serial: str, sign: int | None, least_px: int | None = None
) -> Callable[[float], tuple[Image, str]]:
    """Return a function that gives a source's image nearest to a time, s, and its caption.

    Only such images are decoded. stored: of `path`. sign: of a fingertip, whose contact and angles are drawn
    into the images; None for the camera. least_px: height that is enough; images of twice this height are
    decoded at half their size, which is faster. Raises `SessionError` for a recording without such images.
    """
    messages = stored[serial]
    grasp_ns = lift.zero_ns + round(lift.begins_s.get("A", 0.0) * NS_PER_S)
    untouched = [data for time_ns, data in messages if time_ns < grasp_ns]
    if sign is not None:
        messages = messages[len(untouched) :]
    if not messages or (sign is not None and not untouched):
        raise SessionError(f"{path}: holds no frames of {serial} before and after the grasp")

    begun_ns = np.array([time_ns - lift.zero_ns for time_ns, _ in messages])
    height = 0 if least_px is None else decode_stored(recorded_jpeg(messages[0][1], path)).shape[0]
    shrink = 2 if least_px is not None and height >= 2 * least_px else 1

    def decode(data: bytes) -> Image:
        return decode_stored(recorded_jpeg(data, path), shrink)

    def nearest(time_s: float) -> tuple[float, Image]:
        at = int(np.abs(begun_ns - time_s * NS_PER_S).argmin())
        return begun_ns[at].item() / NS_PER_S, decode(messages[at][1])

    tip = None
    if sign is not None:
        finder = ContactFinder(mean_background([decode(data) for data in untouched[-BACKGROUND_FRAMES:]]))
        tip = tip_at_zero(serial, sign, finder, nearest(0.0)[1])

    def picture(time_s: float) -> tuple[Image, str]:
        seen_s, image = nearest(time_s)
        estimate, truth = angles_at(lift, serial, seen_s)
        if tip is None:
            return image, caption(seen_s, truth)
        return draw_contact(image, tip, estimate, truth), caption(seen_s, estimate, truth)

    return picture


def strip(path: Path, stored: Stored, lift: Lift, serial: str, sign: int | None) -> list[Still]:
    """Return small images of a source over a lift, see `moments`.

    Arguments and errors are those of `pictures`.
    """
    stills, picture_at = [], pictures(path, stored, lift, serial, sign)
    largest_s = largest_error_s(lift)
    for time_s in moments(lift):
        picture, text = picture_at(time_s)
        text += ", largest error" if time_s == largest_s else ""
        scale = min(1.0, LONG_SIDE_PX / max(picture.shape[:2]))
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        stills.append(still(np.asarray(small, np.uint8), text))
    return stills


def still(picture: Image, text: str) -> Still:
    """Encode an image, (H, W, 3) uint8 RGB, with its caption."""
    height, width = picture.shape[:2]
    return Still(encode_jpeg(picture, JPEG_QUALITY), text, (width, height))


def largest_error_s(lift: Lift) -> float | None:
    """Return the time of the largest error in B and C, s; None if no error is known."""
    errors = np.where(lift.within("B", "C"), np.abs(lift.error_deg), np.nan)
    return float(lift.estimate.time_s[np.nanargmax(errors)]) if np.isfinite(errors).any() else None


def moments(lift: Lift, count: int = FRAMES) -> list[float]:
    """Return the times of images, s: the zero, equal steps of the rotation, the largest error, the end."""
    start, end = lift.begins_s.get("B", 0.0), lift.begins_s.get("lower", 0.0)
    onset = lift.onset_truth_s if lift.onset_truth_s is not None else start
    turned = lift.truth.known
    settled = end
    if turned.time_s.size:
        final = turned.angle_deg[-1]
        late = turned.time_s[np.abs(turned.angle_deg - final) < 0.05 * max(abs(final), 1.0)]
        settled = float(late[late > onset].min(initial=end))
    if settled < onset + SHORTEST_S:  # a caught slip
        settled = end
    largest_s = largest_error_s(lift)
    largest = [] if largest_s is None else [largest_s]
    steps = np.linspace(onset, settled, count - 1 - len(largest))[1:].tolist()
    return sorted([start, *steps, *largest, max(end - 0.05, start)])


def read_tip(path: Path, lift: Lift, serial: str, sign: int) -> TipFrames:
    grasp_ns = lift.zero_ns + round(lift.begins_s.get("A", 0.0) * NS_PER_S)
    frames = list(recorded_frames(path, serial, gaps=[]))
    reference = [f.image for f in frames if f.time_ns < grasp_ns]
    frames = [f for f in frames if f.time_ns >= grasp_ns]
    if not reference or not frames:
        raise SessionError(f"{path}: holds no frames of {serial} before and after the grasp")
    zero = min(frames, key=lambda frame: abs(frame.time_ns - lift.zero_ns))
    finder = ContactFinder(mean_background(reference))
    return replace(tip_at_zero(serial, sign, finder, zero.image), frames=tuple(frames))


def tip_at_zero(serial: str, sign: int, finder: ContactFinder, zero: Image | None) -> TipFrames:
    """Return the data for drawing. zero: frame at the zero, (H, W, 3) uint8 RGB, or None."""
    contact = None if zero is None else finder.find(zero)
    axis = None if contact is None or contact.mask is None else ellipse_axis(contact.contour)
    return TipFrames(serial, sign, finder, None if axis is None else axis.angle_deg)


def draw_contact(image: Image, tip: TipFrames, estimate_deg: float, truth_deg: float) -> Image:
    """Draw contact and axes into a copy of a frame, (H, W, 3) uint8 RGB; NaN angles are left out."""
    picture = image.copy()
    contact = tip.finder.find(image)
    if contact.mask is None:
        return picture
    cv2.polylines(picture, [np.rint(contact.contour).astype(np.int32)], True, _WHITE, 1, cv2.LINE_AA)
    middle = contact.contour.reshape(-1, 2).mean(axis=0)
    for angle, colour, thick in ((truth_deg, TRUTH.light, 5), (estimate_deg, ESTIMATE.dark, 2)):
        if tip.axis_deg is not None and math.isfinite(angle):
            # image angles: counter-clockwise as seen, y down
            turn = math.radians(tip.axis_deg + tip.sign * angle)
            arm = _ARM_SHARE * picture.shape[0] * np.array([math.cos(turn), -math.sin(turn)])
            ends = [tuple(np.rint(middle + side * arm).astype(int).tolist()) for side in (-1, 1)]
            cv2.line(picture, ends[0], ends[1], rgb(colour), thick, cv2.LINE_AA)
    return picture


def angles_at(lift: Lift, serial: str, time_s: float) -> tuple[float, float]:
    """Return a fingertip's angle and the marker angle nearest to a time, deg, NaN if unknown."""
    truth, curve = lift.truth.at(np.array([time_s]))[0], lift.tips.get(serial, lift.estimate)
    nearest = curve.angle_deg[np.abs(curve.time_s - time_s).argmin()] if curve.time_s.size else math.nan
    return float(nearest), float(truth)


def caption(time_s: float, angle_deg: float, marker_deg: float | None = None) -> str:
    """Return a caption with time and angle. marker_deg: None to leave the marker angle out."""
    marker = "" if marker_deg is None else f", marker {angle_text(marker_deg)}"
    return f"{round(time_s, 2) + 0.0:.2f} s: {angle_text(angle_deg)}{marker}"


def rgb(hex_colour: str) -> tuple[int, int, int]:
    """Convert a colour to the tuple that OpenCV needs for RGB images."""
    red, green, blue = (int(hex_colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue
