"""What is known of one fingertip during a lift: its estimator, its answers, its zero."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import to_ns
from drivers.types import Image
from rig.lift.fusion import TipAnswer
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.touch import TouchDebounce
from rig.tactile.sample import SlipSample, TactileEstimator

ZERO_S = 0.4
"""How much of the end of phase A gives the zero: 12 camera frames at 30 Hz (at least 10 needed).

Where a slow camera or a hidden marker leaves fewer, all the time at rest before the lift is looked at.
"""


@dataclass(slots=True)
class TipTrack:
    """What is known of one fingertip during a lift."""

    sign: int
    reference: list[Image] = field(default_factory=list)
    estimator: TactileEstimator | None = None
    samples: list[SlipSample] = field(default_factory=list)
    zero_deg: float | None = None
    zero_sample: SlipSample | None = None
    touch: TouchDebounce = field(default_factory=TouchDebounce)
    finder: ContactFinder | None = None
    outlined_ns: int | None = None

    def answer(self, sample: SlipSample, before: SlipSample | None = None) -> TipAnswer:
        """Sign an estimate and take it from its zero; without a zero there is no answer."""
        angle = self._turned(sample)
        if angle is None:
            return TipAnswer(sample, None, None)
        rate = None if sample.rate_deg_s is None else self.sign * sample.rate_deg_s
        last = None if before is None else self._turned(before)
        since = None if before is None or last is None else (before.time_ns, last)
        return TipAnswer(sample, angle, sample.sigma_since(self.zero_sample), rate, since)

    def set_zero(self, samples: Sequence[SlipSample], time_ns: int) -> None:
        """Take the mean of what was answered in the last moments before a time as zero."""
        since = time_ns - to_ns(ZERO_S)
        late = [s for s in samples if since <= s.time_ns < time_ns and s.angle_deg is not None]
        angles_deg = [s.angle_deg for s in late if s.angle_deg is not None]
        self.zero_deg = float(np.mean(angles_deg)) if angles_deg else None
        self.zero_sample = late[-1] if late else None

    def newest(self) -> TipAnswer:
        """Return the newest answer; there has to be a sample."""
        return self.answer(self.samples[-1], self.samples[-2] if len(self.samples) > 1 else None)

    def _turned(self, sample: SlipSample) -> float | None:
        if sample.angle_deg is None or self.zero_deg is None:
            return None
        return self.sign * (sample.angle_deg - self.zero_deg)
