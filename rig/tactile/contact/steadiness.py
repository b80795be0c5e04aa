"""Detect when a contact has stopped growing, and when it counts as touch.

A reference frame taken before a contact has stopped growing would soon be outdated.
"""

from dataclasses import dataclass

SETTLED_SHARE = 0.05
"""Largest relative change of a level that counts as no change."""

Levels = tuple[float, ...]
"""Levels of a contact in one frame: its area, and its strength if known."""


def changed(levels: Levels, before: Levels | None, share: float) -> bool:
    """Whether a level differs from an earlier frame's by more than a fraction; True without earlier frame."""
    if before is None:
        return True
    return any(abs(now / was - 1.0) > share for now, was in zip(levels, before, strict=True))


class Steadiness:
    """Tracks one contact from its first frame on; sets `settled` if its levels stay within `SETTLED_SHARE`.

    frames: number of frames over which the levels have to stay, including the first. drifting: whether each
    frame is compared with the previous one, which permits a slow drift; otherwise with the first.
    """

    def __init__(self, frames: int, drifting: bool = False) -> None:
        self.settled = False
        self._frames, self._drifting = frames, drifting
        self._steady = 0
        self._levels: Levels | None = None

    def update(self, levels: Levels) -> bool:
        """Process the levels of the next frame; return whether they have changed."""
        moved = changed(levels, self._levels, SETTLED_SHARE)
        if moved or self._drifting:
            self._levels = levels
        self._steady = 1 if moved else self._steady + 1
        self.settled = self._steady >= self._frames
        return moved


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
