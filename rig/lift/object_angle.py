"""The angle of the object: fuse the samples of the fingertips as they arrive."""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import to_ns
from rig.lift.fusion import FusedAngles
from rig.lift.onset import leaves_rest
from rig.tactile.sample import SlipSample

ZERO_S = 0.4
"""Length of the end of phase A whose mean angle is the zero, s: 12 camera frames at 30 Hz (at least 10
needed).

If a slow camera or a hidden marker leaves fewer, the whole time at rest before the lift is used.
"""


@dataclass(slots=True)
class TipTrack:
    """The samples of one fingertip in a lift, and its zero. sign: from its angle to the object's angle."""

    sign: int
    samples: list[SlipSample] = field(default_factory=list)
    zero_deg: float | None = None
    zero_sample: SlipSample | None = None

    def answer(self, sample: SlipSample) -> SlipSample:
        """Return a sample with the signed angle since the zero; without a zero there is no angle."""
        return sample.turned(self.sign, self.zero_deg, self.zero_sample)

    def set_zero(self, time_ns: int) -> None:
        """Take the mean angle of the last `ZERO_S` before a time as the zero.

        If the contact has settled since then, the earlier angles are left out: they have another zero.
        """
        since = time_ns - to_ns(ZERO_S)
        late = [s for s in self.samples if since <= s.time_ns < time_ns and s.angle_deg is not None]
        late = [s for s in late if s.settled] or late
        angles_deg = [s.angle_deg for s in late if s.angle_deg is not None]
        self.zero_deg = float(np.mean(angles_deg)) if angles_deg else None
        self.zero_sample = late[-1] if late else None

    def newest(self) -> SlipSample:
        """Return the answer of the newest sample. There must be at least one sample."""
        return self.answer(self.samples[-1])

    def previous(self) -> SlipSample | None:
        return self.answer(self.samples[-2]) if len(self.samples) > 1 else None


class ObjectAngle:
    """Fuses the samples of the fingertips of one lift.

    signs: of the fingertips by serial. From `begin` on, each sample gives one fused sample in `fused`.
    `alarm_ns` is the time of the first fused sample that shows a slip.
    """

    def __init__(self, signs: Mapping[str, int]) -> None:
        self.tips = {serial: TipTrack(sign) for serial, sign in signs.items()}
        self.fused: list[SlipSample] = []
        self.alarm_ns: int | None = None
        self._begun = False
        self._fusion = FusedAngles()

    @property
    def samples(self) -> list[SlipSample]:
        return [sample for tip in self.tips.values() for sample in tip.samples]

    def begin(self, time_ns: int) -> None:
        """Begin the lift: the zero is the angle just before this time."""
        for tip in self.tips.values():
            tip.set_zero(time_ns)
        self._begun = True

    def add(self, serial: str, sample: SlipSample) -> None:
        tip = self.tips[serial]
        tip.samples.append(sample)
        if not self._begun:
            return
        others = [other.newest() for other in self.tips.values() if other is not tip and other.samples]
        fused = self._fusion.update(tip.newest(), others, tip.previous())
        self.fused.append(fused)
        if self.alarm_ns is None and fused.angle_deg is not None and fused.rate_deg_s is not None:
            self.alarm_ns = fused.time_ns if leaves_rest(fused.angle_deg, fused.rate_deg_s) else None


def object_angle(
    signs: Mapping[str, int], samples: Mapping[str, Sequence[SlipSample]], lift_ns: int
) -> ObjectAngle:
    """Return the object's angle of stored samples, in the order of capture. signs, samples: by serial.

    lift_ns: start of the lift, from which on samples are fused.
    """
    angle, begun = ObjectAngle(signs), False
    in_order = heapq.merge(*([(s.time_ns, n, s) for s in samples[n]] for n in signs), key=lambda s: s[:2])
    for time_ns, serial, sample in in_order:
        if not begun and time_ns >= lift_ns:
            angle.begin(lift_ns)
            begun = True
        angle.add(serial, sample)
    return angle
