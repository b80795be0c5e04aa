"""The slip alarm over the frames of one sensor. It is armed by the lift, as in a trial, not by the grasp.

While the fingers close, the contact grows and shifts, and a rotation during that time is not a slip. In a
trial the start of the lift arms the alarm. If the time of the lift is unknown, closing is over once the
contact has stopped growing. A contact after half a second without contact is a new grasp.
"""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.clock import NS_PER_S
from rig.lift.onset import OnsetAlarm
from rig.tactile.contact.gate import Steadiness
from rig.tactile.sample import SlipSample

STABLE_FRAMES = 6
"""A contact whose area is constant over this many frames has stopped growing."""
NEW_GRASP_NS = NS_PER_S // 2


def slips(samples: Sequence[SlipSample], lift_ns: int | None = None) -> list[bool | None]:
    """Return for each frame whether the slip alarm has been raised in this grasp.

    lift_ns: start of the lift, None if unknown. All values are None for an estimator that reports no rate,
    because the alarm needs the rate.
    """
    if all(sample.rate_deg_s is None for sample in samples):
        return [None] * len(samples)
    if lift_ns is not None:
        return list(_by_lift(samples, lift_ns))
    alarm = SlipAlarm()
    return [alarm.update(sample) for sample in samples]


class SlipAlarm:
    """The slip alarm of one sensor, frame by frame: armed by `arm`, or when the contact stops growing."""

    def __init__(self) -> None:
        self._grasp, self._growth = _Grasp(), Steadiness(STABLE_FRAMES)
        self._armed = False
        self._seen_ns: int | None = None

    @property
    def settled(self) -> bool:
        """Whether the contact of this grasp has stopped growing."""
        return self._growth.settled

    def update(self, sample: SlipSample) -> bool:
        """Process the next frame's sample; return whether the alarm has been raised in this grasp."""
        if sample.contact_area_px > 0.0:
            if self._seen_ns is not None and sample.time_ns - self._seen_ns > NEW_GRASP_NS:
                self._grasp, self._growth, self._armed = _Grasp(), Steadiness(STABLE_FRAMES), False
            self._seen_ns = sample.time_ns
            if not self._growth.settled:
                self._growth.update((sample.contact_area_px,))
        self._grasp.update(sample, self._armed or self._growth.settled)
        return self._grasp.slipped

    def arm(self) -> None:
        """Arm the alarm at the next angle, whether or not it was raised before."""
        self._grasp, self._armed = _Grasp(), True


def _by_lift(samples: Sequence[SlipSample], lift_ns: int) -> Iterator[bool]:
    grasp = _Grasp()
    for sample in samples:
        grasp.update(sample, sample.time_ns >= lift_ns)
        yield grasp.slipped


class _Grasp:
    """The alarm of one grasp.

    Its zero is the mean of the last angles before it was armed, or the first angle afterwards if there were
    none.
    """

    def __init__(self) -> None:
        self._alarm = OnsetAlarm()
        self._before: deque[float] = deque(maxlen=STABLE_FRAMES)
        self._zero_deg: float | None = None

    @property
    def slipped(self) -> bool:
        """Whether the alarm has been raised."""
        return self._alarm.raised_ns is not None

    def update(self, sample: SlipSample, armed: bool) -> None:
        """Process the next sample."""
        if sample.angle_deg is None:
            return
        if self._zero_deg is None:
            self._before.append(sample.angle_deg)
            self._zero_deg = float(np.mean(self._before)) if armed else None
        elif armed:
            self._alarm.update(sample.time_ns, sample.angle_deg - self._zero_deg, sample.rate_deg_s)
