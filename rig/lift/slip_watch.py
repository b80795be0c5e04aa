"""Slip events that need a reaction, with thresholds from each fingertip's own noise at rest; reactions.

In lifts without reactions, `rig.lift.onset.leaves_rest` raises a single event instead.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from protocols.observer import ReactionStep
from rig.lift.onset import departure_ns
from rig.sessions.records import ReactionRecord, SlipThreshold
from rig.tactile.angles import LONGEST_GAP_NS, Angles
from rig.tactile.sample import SlipSample

AGREES = 0.4
"""Every answering fingertip must show this fraction of a slip, because an object rotates under all of
them."""
GIVES_DEG = 0.3
"""Largest rotation of a gel that holds and yields under the weight; that is no slip (contract: 0.5 is)."""
DRIFTS_S = 5.0
"""Time constant with which the rest angle follows a drifting fingertip; no slip is that slow."""
REST_NS = 100_000_000
"""A fingertip without rotation for this long is at rest."""
TRUE_REST_NS = 100_000_000
"""Length of the interval before a reaction over which the true angle at rest is averaged."""
GROWTH_NS = 50_000_000
"""Interval over which the growth of the rate is measured."""
LEAST_NOISE_DEG, LEAST_NOISE_DEG_S = 0.002, 0.02
"""Lower bounds of the noise: no image resolves less, and without noise the estimator did not process the
image."""


def sigmas_for(false_alarms_per_hour: float, answers_per_s: float) -> float:
    """Return the number of sigmas by which angle and rate must both leave rest.

    The answers of a resting fingertip are assumed independent, and angle and rate independent and normal.
    Then an answer is a false alarm with twice the square of the one-sided tail (either direction). Raises
    `InputError` for a rate that no threshold gives.
    """
    share = false_alarms_per_hour / (3600.0 * answers_per_s)
    if not 0.0 < share < 0.5:
        raise InputError(
            f"--alarms-per-hour {false_alarms_per_hour:g} is out of range for {answers_per_s:.0f} "
            "answers per second: give more than 0 and less than half as many as there are"
        )
    return -NormalDist().inv_cdf(math.sqrt(share / 2.0))


@dataclass(slots=True)
class TipWatch:
    """One fingertip's noise at rest, and its answers since. Angles from the trial's zero."""

    angle_deg: float
    rate_deg_s: float
    base_deg: float = 0.0
    sigma_deg: float = 1.0
    _seen: deque[tuple[int, float, float]] = field(default_factory=deque)

    @classmethod
    def from_rest(cls, answers: Sequence[SlipSample], false_alarms_per_hour: float) -> "TipWatch | None":
        """Estimate thresholds from answers at rest; None if too few have a rate."""
        known = [
            (a.time_ns, a.angle_deg, a.rate_deg_s)
            for a in answers
            if a.angle_deg is not None and a.rate_deg_s is not None
        ]
        if len(known) < 10:
            return None
        times, angles, rates = (np.array(column, float) for column in zip(*known, strict=True))
        sigmas = sigmas_for(false_alarms_per_hour, NS_PER_S / float(np.median(np.diff(times))))
        angle = sigmas * max(float(np.std(angles)), LEAST_NOISE_DEG)
        return cls(angle, sigmas * max(float(np.sqrt(np.mean(rates**2))), LEAST_NOISE_DEG_S))

    def update(self, answer: SlipSample) -> None:
        """Process an answer since the lift began; refused ones are ignored."""
        if answer.angle_deg is None or answer.rate_deg_s is None:
            return
        time_ns = answer.time_ns
        if self._seen:
            spent_s = (time_ns - self._seen[-1][0]) / NS_PER_S
            self.base_deg += (answer.angle_deg - self.base_deg) * min(spent_s / DRIFTS_S, 1.0)
        self._seen.append((time_ns, answer.angle_deg, answer.rate_deg_s))
        while time_ns - self._seen[0][0] > REST_NS:
            self._seen.popleft()
        self.sigma_deg = answer.sigma_deg or self.sigma_deg

    @property
    def away_deg(self) -> float:
        return self._seen[-1][1] - self.base_deg if self._seen else 0.0

    @property
    def newest_rate_deg_s(self) -> float:
        return self._seen[-1][2] if self._seen else 0.0

    def slips(self, away_deg: float, agreed_deg: float) -> bool:
        """Whether the fingertip is rotating, and has rotated far enough for a slip.

        away_deg: rotation since rest, mean of all fingertips. agreed_deg: smallest one in that direction.
        """
        rate = self.newest_rate_deg_s
        turning = abs(rate) >= self.rate_deg_s and away_deg * rate > 0.0
        least_deg = GIVES_DEG + self.angle_deg
        return turning and min(abs(away_deg), abs(self.away_deg), agreed_deg / AGREES) >= least_deg

    def weight(self, now_ns: int) -> float:
        """Weight among the fingertips: inverse variance of its newest answer; 0 without a recent one."""
        lately = self._seen and now_ns - self._seen[-1][0] <= REST_NS
        return 1.0 / max(self.sigma_deg, LEAST_NOISE_DEG) ** 2 if lately else 0.0

    def predicted_deg(self, after_s: float) -> float:
        """Return the rotation after a time, from the newest angle, its rate and the rate's growth."""
        if not self._seen:
            return 0.0
        time_ns, angle, rate = self._seen[-1]
        before = next(s for s in self._seen if time_ns - s[0] <= GROWTH_NS)
        spent_s = (time_ns - before[0]) / NS_PER_S
        growth = (abs(rate) - abs(before[2])) / spent_s if spent_s > 0.0 else 0.0
        return abs(angle) + abs(rate) * after_s + 0.5 * max(growth, 0.0) * after_s**2

    def at_rest(self, now_ns: int) -> bool | None:
        """Whether no rotation was detected for `REST_NS`; None without an answer in that time."""
        late = [rate for time_ns, _, rate in self._seen if now_ns - time_ns <= REST_NS]
        return all(abs(rate) < self.rate_deg_s for rate in late) if late else None

    def rearm(self) -> None:
        if self._seen:
            self.base_deg = float(np.mean([angle for _, angle, _ in self._seen]))


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


Step = tuple[ReactionStep, int, int]
"""A step of a reaction, its time in ns, and the position of the fingers."""
LAST = (ReactionStep.REST, ReactionStep.ENDS)


class SlipWatch:
    """The slip events of the fingertips in one lift, and the steps of the reactions to them."""

    def __init__(self, settings: SlipSettings) -> None:
        self.events: list[SlipEvent] = []
        self.steps: list[Step] = []
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
        return self._settings.max_turn_deg

    @property
    def ended(self) -> bool:
        return any(step is ReactionStep.ENDS for step, _, _ in self.steps)

    def begin(self, at_rest: Mapping[str, Sequence[SlipSample]]) -> None:
        """Learn each fingertip's noise from its answers at rest, just before the lift."""
        share = self._settings.false_alarms_per_hour / max(len(at_rest), 1)
        watched = {serial: TipWatch.from_rest(answers, share) for serial, answers in at_rest.items()}
        self._tips = {serial: tip for serial, tip in watched.items() if tip is not None}

    def thresholds(self) -> dict[str, SlipThreshold]:
        """Return the thresholds of a slip by serial."""
        return {n: SlipThreshold(GIVES_DEG + tip.angle_deg, tip.rate_deg_s) for n, tip in self._tips.items()}

    def records(self, truth: Angles, lift_ns: int) -> tuple[ReactionRecord, ...]:
        """Return a record of each completed reaction. truth: since the zero. lift_ns: start of phase B."""
        found: list[ReactionRecord] = []
        steps: list[Step] = []
        since_ns = lift_ns
        for step in self.steps:
            steps.append(step)
            if step[0] in LAST:
                found.append(_record(steps, self.events, truth, lift_ns, (since_ns, step[1])))
                steps, since_ns = [], step[1]
        return tuple(found)

    def update(self, serial: str, answer: SlipSample) -> None:
        self._now_ns = answer.time_ns
        tip = self._tips.get(serial)
        if tip is None:
            return
        tip.update(answer)
        if self._raised_ns is None:
            away_deg, agreed_deg = self._away_deg()
            if tip.slips(away_deg, agreed_deg) and self._goes_on(away_deg):
                self._raised_ns = self._now_ns
        if self._raised_ns is None or self._pending is not None:
            return
        limit = self.max_turn_deg
        if limit is None or tip.predicted_deg(self._closing_s) >= limit:
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

    def add_step(self, step: ReactionStep, time_ns: int, position: int) -> None:
        """Process a step of a reaction; after the last step the fingertips detect the next slip."""
        self.steps.append((step, time_ns, position))
        if step in (ReactionStep.CLOSE, *LAST):
            self._count()
        if step is ReactionStep.CLOSED:
            stop_ns = next(t for s, t, _ in reversed(self.steps) if s is ReactionStep.STOP)
            self._closing_s = (time_ns - stop_ns) / NS_PER_S
        if step in LAST:
            self._pending, self._raised_ns, self._counted = None, None, False
            for tip in self._tips.values():
                tip.rearm()

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


def _record(
    steps: Sequence[Step], events: Sequence[SlipEvent], truth: Angles, lift_ns: int, span: tuple[int, int]
) -> ReactionRecord:
    (_, command_ns, position), (last, end_ns, end_position) = steps[0], steps[-1]
    event = next((event for event in events if span[0] <= event.due_ns <= span[1]), None)
    times_ns = {
        "onset": _onset_ns(truth, *span),
        "event": None if event is None else event.raised_ns,
        "command": command_ns,
        "standstill": max(t for s, t, _ in steps if s in (ReactionStep.STANDS, ReactionStep.CLOSED)),
        "rest": end_ns if last is ReactionStep.REST else None,
    }
    values: dict[str, Any] = {}
    for name, time_ns in times_ns.items():
        values[f"{name}_s"] = seconds_since(lift_ns, time_ns)
        values[f"{name}_turn_deg"] = None if time_ns is None else truth.at_ns(time_ns)
    serial = None if event is None else event.serial
    return ReactionRecord(serial=serial, counts_added=end_position - position, **values)


def _onset_ns(truth: Angles, since_ns: int, until_ns: int) -> int | None:
    """Return when the object had rotated 0.5 degrees from its rest before, within a span."""
    before = (truth.time_ns <= since_ns) & (truth.time_ns > since_ns - TRUE_REST_NS)
    rest_deg = float(np.mean(truth.angle_deg[before])) if before.any() else 0.0
    during = (truth.time_ns > since_ns) & (truth.time_ns <= until_ns + LONGEST_GAP_NS)
    return departure_ns(truth.time_ns[during], truth.angle_deg[during], rest_deg)


def seconds_since(start_ns: int, time_ns: int | None) -> float | None:
    """Return the time from one time of a lift to another, s; None if the latter is None."""
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S
