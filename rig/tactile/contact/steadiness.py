"""When a contact has settled: until then it grows, and a reference taken of it is soon out of date."""

SETTLED_SHARE = 0.05

Levels = tuple[float, ...]
"""How large or strong a contact is in one frame: its area, and its strength where that is known."""


def changed(levels: Levels, before: Levels | None, share: float) -> bool:
    """Whether any level differs from an earlier frame's by more than a share; True with no earlier frame."""
    if before is None:
        return True
    return any(abs(now / was - 1.0) > share for now, was in zip(levels, before, strict=True))


class Steadiness:
    """Follows one contact from its first touch on; it has settled once its levels stay for some frames.

    They stay when they remain within `SETTLED_SHARE`. frames: how many, the first of them included.
    drifting: each frame is compared with the one before, which lets a slow drift pass; else with the first.
    """

    def __init__(self, frames: int, drifting: bool = False) -> None:
        self.settled = False
        self._frames, self._drifting = frames, drifting
        self._steady = 0
        self._levels: Levels | None = None

    def update(self, levels: Levels) -> bool:
        """Take the next frame's contact; whether its levels have changed."""
        moved = changed(levels, self._levels, SETTLED_SHARE)
        if moved or self._drifting:
            self._levels = levels
        self._steady = 1 if moved else self._steady + 1
        self.settled = self._steady >= self._frames
        return moved
