"""The slip alarm over the frames of one sensor: on while the object turns in a settled contact.

While the fingers close, the contact grows and shifts, and a rotation during that time is not a slip. In a
trial the start of the lift arms the alarm. If the time of the lift is unknown, closing is over once the
estimator reports that the contact has settled.
"""

from collections import deque
from collections.abc import Sequence

from drivers.clock import to_ns
from rig.lift.onset import ALARM_RATE_DEG_S, ONSET_DEG, leaves_rest
from rig.lift.slip_watch import REST_NS
from rig.tactile.sample import SlipSample, State
from rig.tactile.settling import NEW_GRASP_NS

REST_MEAN_NS = to_ns(0.07)
"""Time over which angles are averaged to that at rest, of two frames at least: a single one is off by up to
0.4 degrees in a contact that shows the rotation badly."""
LEAST_SIGMAS = 0.2
"""Least rotation in sigmas of this contact's angle. With it at most one of 25 SIMULATED presses at rest
raises the alarm, in eight sets; presses that turn by 5 or 15 degrees a second raise it at 0.6 or 0.8 degrees
(median, `tests/unit/rig/live/test_presses.py`)."""
KEPT_SLIPS = 20
"""Number of slips whose times are kept, so that the memory is bounded."""


def slips(samples: Sequence[SlipSample], lift_ns: int | None = None) -> list[bool | None]:
    """Return for each frame whether the slip alarm is on.

    lift_ns: start of the lift, None if unknown. All values are None for an estimator that reports no rate,
    because the alarm needs the rate.
    """
    if all(sample.rate_deg_s is None for sample in samples):
        return [None] * len(samples)
    if lift_ns is None:
        alarm = SlipAlarm()
        return [alarm.update(sample) for sample in samples]
    watch, on = _TurnWatch(), []
    for sample in samples:
        if sample.time_ns >= lift_ns:
            watch.update(sample)
        on.append(watch.on)
    return on


class SlipAlarm:
    """The slip alarm of one sensor, frame by frame: armed by `arm`, or when the contact has settled.

    It ends with the contact, or when the object has been at rest for `REST_NS`; it is then armed for the next
    slip. raised_ns: times of the frames in which it was raised, the newest `KEPT_SLIPS`.
    """

    def __init__(self) -> None:
        self.raised_ns: deque[int] = deque(maxlen=KEPT_SLIPS)
        self._watch: _TurnWatch | None = None
        self._settled = False
        self._seen_ns: int | None = None

    def update(self, sample: SlipSample) -> bool:
        """Process the next frame's sample; return whether the alarm is on."""
        if self._seen_ns is not None and sample.time_ns - self._seen_ns > NEW_GRASP_NS:
            self._watch, self._settled, self._seen_ns = None, False, None
        if sample.shows_contact:
            self._seen_ns = sample.time_ns
            if sample.settled and not self._settled:
                self.arm()
            self._settled = bool(sample.settled)
        if self._watch is None:
            return False
        if self._watch.update(sample):
            self.raised_ns.append(sample.time_ns)
        return self._watch.on

    def arm(self) -> None:
        """Arm the alarm at the next angle, whether or not it is on."""
        self._watch = _TurnWatch()


class _TurnWatch:
    """Detects rotations from the angle at rest, which is the mean of the angles in the first `REST_MEAN_NS`.

    A rotation is at least `ONSET_DEG`, and `LEAST_SIGMAS` of the deviation that its contact has by itself.
    A step of the angle in a frame with another keyframe is no rotation. After a rotation the angle at which
    it has ended is that at rest.
    """

    def __init__(self) -> None:
        self.on = False
        """Whether the object rotates, or has rotated within the last `REST_NS`."""
        self._rest_deg, self._last_deg, self._frames = 0.0, 0.0, 0
        self._turned_ns, self._began_ns = 0, 0

    def update(self, sample: SlipSample) -> bool:
        """Process the next sample; return whether a rotation has begun in it."""
        angle_deg, rate_deg_s = sample.angle_deg, sample.rate_deg_s
        if self.on:
            self._end(sample)
        elif angle_deg is not None and rate_deg_s is not None:
            if sample.state is State.REKEYED:
                self._rest_deg += angle_deg - self._last_deg
            self._last_deg = angle_deg
            turned_deg = angle_deg - self._rest_deg if self._frames else 0.0
            # Since itself, a sample has no unseen rotation in its sigma.
            own_deg = sample.since_zero(1, 0.0, sample).sigma_deg or 0.0
            least_deg = max(ONSET_DEG, LEAST_SIGMAS * own_deg)
            if abs(turned_deg) >= least_deg and leaves_rest(turned_deg, rate_deg_s):
                self.on, self._turned_ns = True, sample.time_ns
                return True
            if self._frames == 0:
                self._began_ns = sample.time_ns
            if self._frames < 2 or sample.time_ns - self._began_ns < REST_MEAN_NS:
                self._frames += 1
                self._rest_deg += (angle_deg - self._rest_deg) / self._frames
        return False

    def _end(self, sample: SlipSample) -> None:
        """End the alarm after `REST_NS` without rotation; a contact without angle may still rotate."""
        unknown = sample.shows_contact and sample.rate_deg_s is None
        if unknown or abs(sample.rate_deg_s or 0.0) >= ALARM_RATE_DEG_S:
            self._turned_ns = sample.time_ns
        elif sample.time_ns - self._turned_ns >= REST_NS:
            self.on, self._frames = False, 0
            if sample.angle_deg is not None:
                self._rest_deg, self._frames, self._began_ns = sample.angle_deg, 2, 0
                self._last_deg = sample.angle_deg
