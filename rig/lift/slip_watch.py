"""Slip events that need a reaction, with thresholds from each fingertip's own noise at rest.

In lifts without reactions, `rig.lift.onset.OnsetAlarm` raises a single event instead.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import NS_PER_S
from protocols.observer import ReactionStep
from rig.lift.tip_watch import GIVES_DEG, TipWatch
from rig.tactile.sample import SlipSample

CAUGHT_DEG = 5.0
"""Largest rotation of a caught object, unless another limit is given."""
RESERVE = 1.5
"""The next slip is assumed to be at most this many times as large as the largest so far."""
SOON_S, SLIPS_DEG = 0.1, 1.0
"""A slip is a rotation that at its present rate reaches SLIPS_DEG within SOON_S; a yielding gel comes to
rest."""
FIRST_CLOSING_S = 0.15
"""Assumed time to stop a slip, until a reaction of this lift has been measured."""


@dataclass(frozen=True, slots=True)
class SlipSettings:
    """When to react. false_alarms_per_hour: at rest, over all fingertips.

    max_turn_deg: react only if the rotation would otherwise exceed this; None: react immediately.
    """

    false_alarms_per_hour: float = 10.0
    max_turn_deg: float | None = None


@dataclass(frozen=True, slots=True)
class SlipEvent:
    """A slip that needs a reaction.

    raised_ns: capture time of the frame in which the slip was detected. due_ns: of the frame at which the
    reaction became due.
    """

    serial: str
    raised_ns: int
    due_ns: int


class SlipWatch:
    """The slip events of the fingertips in one lift, and the reactions to them.

    `events` and `steps` are stored in the lift's row; steps: (step, time in ns, position of the fingers).
    """

    def __init__(self, settings: SlipSettings) -> None:
        self.events: list[SlipEvent] = []
        self.steps: list[tuple[ReactionStep, int, int]] = []
        self._settings = settings
        self._tips: dict[str, TipWatch] = {}
        self._now_ns = 0
        self._raised_ns: int | None = None
        self._pending: SlipEvent | None = None
        self._closing_s = FIRST_CLOSING_S
        self._turned_deg = self._largest_deg = 0.0
        self._counted = False

    @property
    def max_turn_deg(self) -> float | None:
        """The permitted rotation, deg, or None."""
        return self._settings.max_turn_deg

    @property
    def ended(self) -> bool:
        """Whether a reaction has ended the lift early."""
        return any(step is ReactionStep.ENDS for step, _, _ in self.steps)

    def begin(self, at_rest: Mapping[str, Sequence[SlipSample]]) -> None:
        """Learn each fingertip's noise from its answers at rest, just before the lift."""
        share = self._settings.false_alarms_per_hour / max(len(at_rest), 1)
        watched = {serial: TipWatch.resting(answers, share) for serial, answers in at_rest.items()}
        self._tips = {serial: tip for serial, tip in watched.items() if tip is not None}

    def thresholds(self) -> dict[str, tuple[float, float]]:
        """Return, by serial, the thresholds of angle since rest (deg) and rate (deg/s) of a slip."""
        return {serial: (GIVES_DEG + tip.angle_deg, tip.rate_deg_s) for serial, tip in self._tips.items()}

    def update(self, serial: str, answer: SlipSample) -> None:
        """Process a fingertip's answer."""
        self._now_ns = answer.time_ns
        tip = self._tips.get(serial)
        if tip is None:
            return
        tip.update(answer)
        if self._raised_ns is None and self._slips(tip):
            self._raised_ns = self._now_ns
        if self._pending is None and self._raised_ns is not None and self._too_late_soon(tip):
            self._pending = SlipEvent(serial, self._raised_ns, self._now_ns)
            self.events.append(self._pending)

    def slip_ns(self) -> int | None:
        """Return the capture time of the frame that needs a reaction; None without one."""
        return None if self._pending is None else self._pending.due_ns

    def at_rest(self) -> bool:
        """Whether no fingertip has detected rotation for 100 ms, and at least one has answered."""
        resting = [tip.at_rest(self._now_ns) for tip in self._tips.values()]
        return any(resting) and False not in resting

    def another_is_too_much(self) -> bool:
        """Whether one more slip, larger than the largest so far, would rotate the object beyond the limit."""
        now_deg = 0.0 if self._counted else self._away_deg()[0]
        turned_deg, largest_deg = self._turned_deg + now_deg, max(self._largest_deg, abs(now_deg))
        return abs(turned_deg) + RESERVE * largest_deg > (self.max_turn_deg or CAUGHT_DEG)

    def reacted(self, step: ReactionStep, time_ns: int, position: int) -> None:
        """Process a step of a reaction; after the last step the fingertips detect the next slip."""
        self.steps.append((step, time_ns, position))
        if step in (ReactionStep.CLOSE, ReactionStep.REST, ReactionStep.ENDS):
            self._count()
        if step is ReactionStep.CLOSED:
            stop_ns = next(t for s, t, _ in reversed(self.steps) if s is ReactionStep.STOP)
            self._closing_s = (time_ns - stop_ns) / NS_PER_S
        if step in (ReactionStep.REST, ReactionStep.ENDS):
            self._pending, self._raised_ns, self._counted = None, None, False
            for tip in self._tips.values():
                tip.rearm()

    def _slips(self, tip: TipWatch) -> bool:
        """Whether a fingertip's newest answer shows a slip."""
        away_deg, agreed_deg = self._away_deg()
        return tip.slips(away_deg, agreed_deg) and self._goes_on(away_deg)

    def _goes_on(self, away_deg: float) -> bool:
        """Whether the rotation will soon be as large as in a slip, by the lowest rate of all fingertips."""
        answering = [tip for tip in self._tips.values() if tip.weight(self._now_ns) > 0.0]
        rate_deg_s = min(math.copysign(1.0, away_deg) * tip.newest_rate_deg_s for tip in answering)
        return abs(away_deg) + max(rate_deg_s, 0.0) * SOON_S >= SLIPS_DEG

    def _count(self) -> None:
        """Add a slip to the total, once, before fingers close: later rotation is caused by the contact."""
        if not self._counted:
            slipped_deg = self._away_deg()[0]
            self._turned_deg += slipped_deg
            self._largest_deg = max(self._largest_deg, abs(slipped_deg))
        self._counted = True

    def _away_deg(self) -> tuple[float, float]:
        """Return the rotation since rest, deg: mean of all answering fingertips, and the smallest one.

        An object rotates under both. Rotation seen by only one is that of its contact, which grows during
        closing.
        """
        weights = [(tip.away_deg, tip.weight(self._now_ns)) for tip in self._tips.values()]
        weighted = [(away, weight) for away, weight in weights if weight > 0.0]
        if not weighted:
            return 0.0, 0.0
        mean = sum(away * weight for away, weight in weighted) / sum(weight for _, weight in weighted)
        return mean, min(math.copysign(1.0, mean) * away for away, _ in weighted)

    def _too_late_soon(self, tip: TipWatch) -> bool:
        limit = self._settings.max_turn_deg
        return limit is None or tip.predicted_deg(self._closing_s) >= limit
