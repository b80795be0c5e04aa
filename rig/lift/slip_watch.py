"""Slip events that ask for a reaction: thresholds from each fingertip's own noise at rest.

Without a reaction `rig.lift.onset.OnsetAlarm` raises its one event; this is for lifts that react.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from protocols.reaction import ReactionStep
from rig.lift.fusion import TipAnswer

GIVES_DEG = 0.3
"""A gel that holds gives way so far as the weight comes onto it; that is no slip (contract: 0.5 is)."""
REST_NS = 100_000_000
"""At rest is what has not turned for so long."""
GROWTH_NS = 50_000_000
"""Over so long the rate's growth is looked at."""
FIRST_CLOSING_S = 0.15
"""How long it takes to stop a slip, until a reaction of this lift has shown it."""
LEAST_NOISE_DEG, LEAST_NOISE_DEG_S = 0.002, 0.02
"""No image resolves less; a rest without any noise is one that the estimator does not look at."""


@dataclass(frozen=True, slots=True)
class SlipSettings:
    """When to react. false_alarms_per_hour: at rest, over all fingertips.

    max_turn_deg: react only when the turn would otherwise become larger; None: at once.
    """

    false_alarms_per_hour: float = 10.0
    max_turn_deg: float | None = None


@dataclass(frozen=True, slots=True)
class SlipEvent:
    """A slip that asks for a reaction. Captures of frames: raised_ns: told of the slip, due_ns: asked."""

    serial: str
    raised_ns: int
    due_ns: int


def sigmas_for(false_alarms_per_hour: float, answers_per_s: float) -> float:
    """Return how many sigmas angle and rate both have to leave rest by.

    A resting fingertip's answers are taken as independent, its angle and its rate too, both normal: then
    one answer is a false alarm with twice the square of one side's tail (either direction). Raises
    `InputError` for a rate that no threshold gives.
    """
    share = false_alarms_per_hour / (3600.0 * answers_per_s)
    if not 0.0 < share < 0.5:
        raise InputError(
            f"--false-alarms-per-hour {false_alarms_per_hour:g} is out of range for {answers_per_s:.0f} "
            "answers per second: give more than 0 and less than half as many as there are"
        )
    return -NormalDist().inv_cdf(math.sqrt(share / 2.0))


@dataclass(slots=True)
class TipWatch:
    """One fingertip's noise at rest, and what it has answered since. Angles from the trial's zero."""

    angle_deg: float
    rate_deg_s: float
    base_deg: float = 0.0
    sigma_deg: float = 1.0
    _seen: deque[tuple[int, float, float]] = field(default_factory=deque)

    @classmethod
    def resting(cls, answers: Sequence[TipAnswer], false_alarms_per_hour: float) -> "TipWatch | None":
        """Learn thresholds from answers at rest; None where too few have a rate."""
        known = [
            (a.sample.time_ns, a.angle_deg, a.rate_deg_s)
            for a in answers
            if a.angle_deg is not None and a.rate_deg_s is not None
        ]
        if len(known) < 10:
            return None
        times, angles, rates = (np.array(column, float) for column in zip(*known, strict=True))
        sigmas = sigmas_for(false_alarms_per_hour, NS_PER_S / float(np.median(np.diff(times))))
        angle = sigmas * max(float(np.std(angles)), LEAST_NOISE_DEG)
        return cls(angle, sigmas * max(float(np.sqrt(np.mean(rates**2))), LEAST_NOISE_DEG_S))

    def update(self, answer: TipAnswer) -> None:
        """Take an answer since the lift began; refused ones tell nothing."""
        if answer.angle_deg is None or answer.rate_deg_s is None:
            return
        time_ns = answer.sample.time_ns
        self._seen.append((time_ns, answer.angle_deg, answer.rate_deg_s))
        while time_ns - self._seen[0][0] > REST_NS:
            self._seen.popleft()
        self.sigma_deg = answer.sample.sigma_deg or self.sigma_deg

    @property
    def away_deg(self) -> float:
        """How far it has turned since rest."""
        return self._seen[-1][1] - self.base_deg if self._seen else 0.0

    def slips(self, away_deg: float) -> bool:
        """Whether it is turning, and has turned so far. away_deg: since rest, by all fingertips."""
        rate = self._seen[-1][2] if self._seen else 0.0
        turning = abs(rate) >= self.rate_deg_s and away_deg * rate > 0.0
        return turning and min(abs(away_deg), abs(self.away_deg)) >= GIVES_DEG + self.angle_deg

    def weight(self, now_ns: int) -> float:
        """How much it counts beside others: what it has answered lately, by its variance."""
        lately = self._seen and now_ns - self._seen[-1][0] <= REST_NS
        return 1.0 / max(self.sigma_deg, LEAST_NOISE_DEG) ** 2 if lately else 0.0

    def predicted_deg(self, after_s: float) -> float:
        """Return the turn after a while, by the newest answer, its rate and the rate's growth."""
        if not self._seen:
            return 0.0
        time_ns, angle, rate = self._seen[-1]
        before = next(s for s in self._seen if time_ns - s[0] <= GROWTH_NS)
        spent_s = (time_ns - before[0]) / NS_PER_S
        growth = (abs(rate) - abs(before[2])) / spent_s if spent_s > 0.0 else 0.0
        return abs(angle) + abs(rate) * after_s + 0.5 * max(growth, 0.0) * after_s**2

    def at_rest(self, now_ns: int) -> bool | None:
        """Whether it has seen no turn for `REST_NS`; None where it has answered nothing meanwhile."""
        late = [rate for time_ns, _, rate in self._seen if now_ns - time_ns <= REST_NS]
        return all(abs(rate) < self.rate_deg_s for rate in late) if late else None

    def rearm(self) -> None:
        """Look for the next slip, from the angle it has now."""
        if self._seen:
            self.base_deg = float(np.mean([angle for _, angle, _ in self._seen]))


class SlipWatch:
    """The fingertips' slip events of one lift, and what was done about them.

    `events` and `steps` are what the lift's row tells of; steps: (step, time in ns, finger counts).
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

    @property
    def max_turn_deg(self) -> float | None:
        """The largest turn asked for, deg, if any."""
        return self._settings.max_turn_deg

    @property
    def ended(self) -> bool:
        """Whether a reaction has ended the lift where it was."""
        return any(step is ReactionStep.ENDS for step, _, _ in self.steps)

    def begin(self, at_rest: Mapping[str, Sequence[TipAnswer]]) -> None:
        """Learn each fingertip's noise from its answers at rest, just before the lift."""
        share = self._settings.false_alarms_per_hour / max(len(at_rest), 1)
        watched = {serial: TipWatch.resting(answers, share) for serial, answers in at_rest.items()}
        self._tips = {serial: tip for serial, tip in watched.items() if tip is not None}

    def thresholds(self) -> dict[str, tuple[float, float]]:
        """Return by serial from which angle since rest and which rate on a slip is told, deg and deg/s."""
        return {serial: (GIVES_DEG + tip.angle_deg, tip.rate_deg_s) for serial, tip in self._tips.items()}

    def update(self, serial: str, answer: TipAnswer) -> None:
        """Take a fingertip's answer."""
        self._now_ns = answer.sample.time_ns
        tip = self._tips.get(serial)
        if tip is None:
            return
        tip.update(answer)
        if self._raised_ns is None and tip.slips(self._away_deg()):
            self._raised_ns = self._now_ns
        if self._pending is None and self._raised_ns is not None and self._too_late_soon(tip):
            self._pending = SlipEvent(serial, self._raised_ns, self._now_ns)
            self.events.append(self._pending)

    def slip_ns(self) -> int | None:
        """When the frame was captured that asks for a reaction, None without one."""
        return None if self._pending is None else self._pending.due_ns

    def at_rest(self) -> bool:
        """Whether no fingertip has seen a turn for 100 ms, and at least one has answered."""
        told = [tip.at_rest(self._now_ns) for tip in self._tips.values()]
        return any(told) and False not in told

    def reacted(self, step: ReactionStep, time_ns: int, counts: int) -> None:
        """Take a step of a reaction; after the last one the fingertips look for the next slip."""
        self.steps.append((step, time_ns, counts))
        if step is ReactionStep.CLOSED:
            stop_ns = next(t for s, t, _ in reversed(self.steps) if s is ReactionStep.STOP)
            self._closing_s = (time_ns - stop_ns) / NS_PER_S
        if step in (ReactionStep.REST, ReactionStep.ENDS):
            self._pending = self._raised_ns = None
            for tip in self._tips.values():
                tip.rearm()

    def _away_deg(self) -> float:
        """How far the object has turned since rest, by all fingertips.

        It turns under both. What one sees alone is its own contact, which grows when the fingers close.
        """
        weights = [(tip, tip.weight(self._now_ns)) for tip in self._tips.values()]
        total = sum(weight for _, weight in weights)
        return sum(tip.away_deg * weight for tip, weight in weights) / total if total > 0.0 else 0.0

    def _too_late_soon(self, tip: TipWatch) -> bool:
        limit = self._settings.max_turn_deg
        return limit is None or tip.predicted_deg(self._closing_s) >= limit
