"""When contact counts as touch: one noisy frame stops nothing."""

from dataclasses import dataclass

TOUCH_FRAMES = 2
"""Contact counts when this many frames in a row show it."""


@dataclass(slots=True)
class TouchDebounce:
    """Counts the frames of one fingertip that show contact, in a row."""

    frames: int = 0

    def update(self, contact: bool) -> None:
        """Take the next frame's contact."""
        self.frames = self.frames + 1 if contact else 0

    @property
    def sure(self) -> bool:
        """Whether the last frames showed contact."""
        return self.frames >= TOUCH_FRAMES
