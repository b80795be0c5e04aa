"""Observers that capture images while the hand grasps: first the reference, then each pose."""

from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.types import Frame, Image
from protocols.observer import LiftEvents
from protocols.record_grasps import CaptureObserver, HandObserver
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.gate import TouchDebounce

FRAMES_APART = 3
"""Images of one grip are this many frames apart, so that they differ by more than noise."""


@dataclass(slots=True)
class PoseCapture(CaptureObserver, HandObserver):
    """An observer that captures images with contact, alternately from each fingertip or from one alone.

    taken: frames with their grip in steps beyond first contact (None: pressed by hand) and contact area, px.
    true_masks: functions that give the true contact mask of simulated fingertips at a time in ns; masks:
    those of the captured images. They do not influence the capture. shown: called with each frame after it
    was processed.
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
        """Capture this many more images at a grip."""
        self._wanted, self._grip_steps, self._serial = len(self.taken) + images, grip_steps, None

    def want_of(self, serial: str, images: int) -> None:
        """Capture this many more images of one fingertip that a person presses."""
        self._wanted, self._grip_steps, self._serial = len(self.taken) + images, None, serial

    def satisfied(self) -> bool:
        """Whether all requested images have been captured."""
        return len(self.taken) >= self._wanted

    def touching(self, serial: str) -> bool:
        """Whether a fingertip has shown contact in its last frames."""
        return serial in self._touches and self._touches[serial].sure

    def frame(self, frame: Frame) -> None:
        """Detect contact; capture the image if one of this fingertip is due."""
        self._capture(frame)
        if self.shown is not None:
            self.shown(frame)

    def _capture(self, frame: Frame) -> None:
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
    """An observer that collects the fingertips' frames without contact."""

    frames: dict[str, list[Image]]

    def frame(self, frame: Frame) -> None:
        """Store a fingertip's frame."""
        if frame.serial in self.frames:
            self.frames[frame.serial].append(frame.image)
