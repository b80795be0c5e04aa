"""Debounce contact, so that a single noisy frame does not stop a motion."""

from dataclasses import dataclass

TOUCH_FRAMES = 2
"""Number of consecutive frames with contact that count as a touch."""


@dataclass(slots=True)
class TouchDebounce:
    """Counts the consecutive frames of one fingertip that show contact."""

    frames: int = 0

    def update(self, contact: bool) -> None:
        """Process the contact of the next frame."""
        self.frames = self.frames + 1 if contact else 0

    @property
    def sure(self) -> bool:
        """Whether the last `TOUCH_FRAMES` frames all showed contact."""
        return self.frames >= TOUCH_FRAMES
