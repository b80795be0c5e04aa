"""The slip alarm over a recording. It is armed by the lift, as in a trial, not by the grasp.

While fingers close, a contact grows and shifts, and what turns then is no slip. In a trial the arm's lift
arms the alarm. A recording may say when that was; where it does not, the grasp is over once the contact
has stopped growing, and a contact that was gone for a while is a new grasp.
"""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.clock import NS_PER_S
from rig.lift.onset import OnsetAlarm
from rig.tactile.contact.steadiness import Steadiness
from rig.tactile.sample import SlipSample

STABLE_FRAMES = 6
"""A contact whose area is constant over this many frames has stopped growing."""
NEW_GRASP_NS = NS_PER_S // 2


def slips(samples: Sequence[SlipSample], lift_ns: int | None = None) -> list[bool | None]:
    """Return for each frame whether the slip alarm has been raised in this grasp.

    lift_ns: when the lift began; None where that is not known. None throughout for an estimator that
    tells no rate: the alarm asks for it.
    """
    if all(sample.rate_deg_s is None for sample in samples):
        return [None] * len(samples)
    return list(_by_lift(samples, lift_ns) if lift_ns is not None else _by_contact(samples))


def _by_lift(samples: Sequence[SlipSample], lift_ns: int) -> Iterator[bool]:
    grasp = _Grasp()
    for sample in samples:
        grasp.update(sample, sample.time_ns >= lift_ns)
        yield grasp.slipped


def _by_contact(samples: Sequence[SlipSample]) -> Iterator[bool]:
    grasp, growth, seen_ns = _Grasp(), Steadiness(STABLE_FRAMES), None
    for sample in samples:
        if sample.contact_area_px > 0.0:
            if seen_ns is not None and sample.time_ns - seen_ns > NEW_GRASP_NS:
                grasp, growth = _Grasp(), Steadiness(STABLE_FRAMES)
            seen_ns = sample.time_ns
            if not growth.settled:
                growth.update((sample.contact_area_px,))
        grasp.update(sample, growth.settled)
        yield grasp.slipped


class _Grasp:
    """One grasp's alarm. Its zero is what was answered last before it is armed, or first thereafter."""

    def __init__(self) -> None:
        self._alarm = OnsetAlarm()
        self._before: deque[float] = deque(maxlen=STABLE_FRAMES)
        self._zero_deg: float | None = None

    @property
    def slipped(self) -> bool:
        """Whether the alarm has been raised."""
        return self._alarm.raised_ns is not None

    def update(self, sample: SlipSample, armed: bool) -> None:
        """Take the next answer."""
        if sample.angle_deg is None:
            return
        if self._zero_deg is None:
            self._before.append(sample.angle_deg)
            self._zero_deg = float(np.mean(self._before)) if armed else None
        elif armed:
            self._alarm.update(sample.time_ns, sample.angle_deg - self._zero_deg, sample.rate_deg_s)
