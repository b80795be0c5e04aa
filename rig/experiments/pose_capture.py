"""Watches that take images while the hand grasps: the reference first, then each pose."""

from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.types import Frame, Image
from protocols.observer import LiftEvents
from protocols.record_by_hand import HandObserver
from protocols.record_grasps import CaptureObserver
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.touch import TouchDebounce

FRAMES_APART = 3
"""Images of one grip are this many frames apart, so that they differ by more than noise."""


@dataclass(slots=True)
class PoseCapture(CaptureObserver, HandObserver):
    """An observer that takes images with contact, turn about from each fingertip or from one alone.

    taken: frames with their grip in steps past first contact (None: pressed by hand) and contact area, px.
    true_masks: what simulated fingertips truly touch at a time in ns; masks: that of each image
    taken. Nothing here looks at them. shown: is given each frame after it was looked at, and changes nothing.
    """

    finders: dict[str, ContactFinder]
    taken: list[tuple[Frame, int | None, float]] = field(default_factory=list)
    true_masks: dict[str, Callable[[int], Image]] = field(default_factory=dict)
    masks: list[Image] = field(default_factory=list)
    rejected: int = 0
    shown: Callable[[Frame], None] | None = None
    _grip_steps: int | None = 0
    _serial: str | None = None
    _wanted: int = 0
    _touches: dict[str, TouchDebounce] = field(default_factory=dict)
    _areas: dict[str, float] = field(default_factory=dict)
    _last: dict[str, int] = field(default_factory=dict)

    def want(self, images: int, grip_steps: int) -> None:
        """Take this many more images at a grip."""
        self._wanted, self._grip_steps, self._serial = len(self.taken) + images, grip_steps, None

    def want_of(self, serial: str, images: int) -> None:
        """Take this many more images of one fingertip, which a hand presses."""
        self._wanted, self._grip_steps, self._serial = len(self.taken) + images, None, serial

    def satisfied(self) -> bool:
        """Whether they have been taken."""
        return len(self.taken) >= self._wanted

    def touching(self, serial: str) -> bool:
        """Whether a fingertip has shown contact in its last frames."""
        return serial in self._touches and self._touches[serial].sure

    def frame(self, frame: Frame) -> None:
        """Look for contact; take the image when one of this fingertip is wanted."""
        self._look(frame)
        if self.shown is not None:
            self.shown(frame)

    def _look(self, frame: Frame) -> None:
        finder = self.finders.get(frame.serial)
        if finder is None:
            return
        area = finder.find(frame.image).area_px
        self._touches.setdefault(frame.serial, TouchDebounce()).update(area > 0)
        if self.satisfied() or not self._due(frame):
            return
        if area > 0:
            self.taken.append((frame, self._grip_steps, area))
            if frame.serial in self.true_masks:
                self.masks.append(self.true_masks[frame.serial](frame.time_ns))
        else:
            self.rejected += 1
        self._last[frame.serial] = frame.sequence

    def _due(self, frame: Frame) -> bool:
        if frame.sequence - self._last.get(frame.serial, -FRAMES_APART) < FRAMES_APART:
            return False
        if self._serial is not None:
            return frame.serial == self._serial
        counts = {serial: sum(f.serial == serial for f, _, _ in self.taken) for serial in self.finders}
        return counts[frame.serial] == min(counts.values())


@dataclass(slots=True)
class ReferenceCapture(LiftEvents):
    """An observer that keeps the fingertips' frames without contact."""

    frames: dict[str, list[Image]]

    def frame(self, frame: Frame) -> None:
        """Keep a fingertip's frame."""
        if frame.serial in self.frames:
            self.frames[frame.serial].append(frame.image)
