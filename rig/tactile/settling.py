"""When a contact has settled: the rule of `slip`, and of all estimators that do not report it themselves.

An estimator reports it with each sample, see `SlipSample.settled`. All other code reads it from there.
"""

from drivers.clock import NS_PER_S, to_ns

SETTLED_SHARE = 0.05
"""Largest relative change of a level that counts as no change."""
SETTLED_S = 0.15
"""Time without change after which a contact has settled. Fingers that close step by step rest for a tenth of
a second between two steps."""
REFERENCE_S = 0.08
"""Time without change after which the estimators `ecc` and `kolamuri` no longer replace their reference."""
NEW_GRASP_NS = NS_PER_S // 2
"""A contact after a longer time without contact is a new grasp; shorter gaps are failed detections."""

Levels = tuple[float, ...]
"""Levels of a contact in one frame: its area, and its strength if known."""


def has_changed(levels: Levels, before: Levels | None, share: float) -> bool:
    """Whether a level differs from an earlier frame's by more than a fraction; True without earlier frame."""
    if before is None:
        return True
    return any(abs(now / was - 1.0) > share for now, was in zip(levels, before, strict=True))


class Settling:
    """Follows the levels of one contact from its first frame on.

    A contact that has settled once stays settled, so that a slip that moves it off the gel does not undo it.

    steady_s: time for which the levels have to stay within `SETTLED_SHARE`. drifting: whether each frame is
    compared with the previous one, which permits a slow drift; otherwise with the first one of that time.
    """

    def __init__(self, steady_s: float = SETTLED_S, drifting: bool = False) -> None:
        self.settled = self.changed = False
        """Whether the contact has stopped growing, and whether it changed in the newest frame before that."""
        self._steady_ns, self._drifting = to_ns(steady_s), drifting
        self._since_ns = 0
        self._levels: Levels | None = None

    def update(self, levels: Levels, time_ns: int) -> bool:
        """Process the levels of the next frame; return whether the contact has settled in this frame."""
        if self.settled:
            return False
        self.changed = has_changed(levels, self._levels, SETTLED_SHARE)
        if self.changed:
            self._since_ns = time_ns
        if self.changed or self._drifting:
            self._levels = levels
        self.settled = not self.changed and time_ns - self._since_ns >= self._steady_ns
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
