"""When a contact has settled: the rule of `slip`, and of all estimators that do not report it themselves.

An estimator reports it with each sample, see `SlipSample.settled`. All other code reads it from there.
"""

from drivers.clock import NS_PER_S, to_ns

SETTLED_SHARE = 0.05
"""Largest relative change of a level that counts as no change."""
LEAST_FRAMES, SETTLED_S = 2, 0.15
"""Frames and time without change after which a contact has settled. Fingers that close step by step rest for
a tenth of a second between two steps."""
REFERENCE_FRAMES = 6
"""Frames without change after which the estimators `ecc` and `kolamuri` no longer replace their reference."""
NEW_GRASP_NS = NS_PER_S // 2
"""A contact after a longer time without contact is a new grasp; shorter gaps are failed detections."""

Levels = tuple[float, ...]
"""Levels of a contact in one frame: its area, and its strength if known."""


def has_changed(levels: Levels, before: Levels | None, share: float) -> bool:
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
        moved = has_changed(levels, self._levels, SETTLED_SHARE)
        if moved or self._drifting:
            self._levels = levels
        self._steady = 1 if moved else self._steady + 1
        self.settled = self._steady >= self._frames
        return moved


class Settling:
    """Follows the levels of one contact from its first frame on.

    A contact that has settled once stays settled, so that a slip that moves it off the gel does not undo it.
    """

    def __init__(self) -> None:
        self.settled = False
        """Whether the contact has stopped growing."""
        self._steadiness = Steadiness(LEAST_FRAMES)
        self._steady_ns = 0

    def update(self, levels: Levels, time_ns: int) -> bool:
        """Process the levels of the next frame; return whether the contact has settled in this frame."""
        if self.settled:
            return False
        if self._steadiness.update(levels):
            self._steady_ns = time_ns
        long_enough = time_ns - self._steady_ns >= to_ns(SETTLED_S)
        self.settled = self._steadiness.settled and long_enough
        return self.settled


class SettlingByArea:
    """Whether the contacts of one sensor have settled, from their areas alone: the default rule."""

    def __init__(self) -> None:
        self._settling, self._seen_ns = Settling(), 0

    def update(self, area_px: float, time_ns: int) -> bool:
        """Process the contact area of the next frame, 0 without contact; return whether it has settled."""
        if area_px <= 0.0:
            return False
        if time_ns - self._seen_ns > NEW_GRASP_NS:
            self._settling = Settling()
        self._seen_ns = time_ns
        self._settling.update((area_px,), time_ns)
        return self._settling.settled
