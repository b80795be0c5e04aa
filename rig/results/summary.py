"""Summarize trials: a table per object, MARE with intervals, advice on refused frames."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from rig.results.metrics import Mare, mare_of
from rig.sessions.records import Lift, LiftOutcome, accepted_lifts

ADVICE = {
    "unobservable": "The contact looks the same at every angle: grasp the object elsewhere or at an edge.",
    "lost": "The image changed more than by a rotation: check the frames for stray light, a new contact or "
    "a finger that moved.",
    "frozen": "The fingertip repeated its picture: check its cable, replug it.",
    "no_contact": "The fingertip detected no contact: grip more firmly, or check if the object slid out.",
}
"""Advice for each state without an angle."""


def main_refusal(states: Iterable[Mapping[str, int]]) -> str:
    """Return the most frequent state without an angle; "lost" if there is none.

    states: frames by state, for each lift.
    """
    counts: Counter[str] = Counter()
    for lift in states:
        counts.update({state: n for state, n in lift.items() if state in ADVICE and n})
    return counts.most_common(1)[0][0] if counts else "lost"


@dataclass(frozen=True, slots=True)
class ReactingSummary:
    """Effect of reactions to slip.

    kind: the reaction. caught: number of lifts whose slip was stopped. early: number of reactions before half
    a degree of rotation. added_counts: steps added to the grip, for each lift that reacted. turns_deg:
    absolute true rotations at the end.
    """

    kind: str
    lifts: int
    caught: int
    reactions: int
    early: int
    added_counts: tuple[int, ...]
    turns_deg: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TrialSummary:
    """Summary of lifts: of a trial, of a table, or of one object.

    name: id and name of the object; "all" for the others, which have a summary of each of their `objects`.
    outcomes: number of lifts by outcome. mare_b: over phase B; mare: over B and C; mare_held: with refused
    frames held. bench_s: total duration by the bench's clock, including failed attempts. turns_deg: final
    true angles of the lifts that have one. reacting: None unless lifts react to slip; their errors are listed
    separately.
    """

    name: str
    objects: tuple["TrialSummary", ...]
    lifts_accepted: int
    outcomes: dict[str, int]
    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    answered: float
    bench_s: float
    turns_deg: tuple[float, ...]
    reacting: ReactingSummary | None = None

    @property
    def outcomes_text(self) -> str:
        return ", ".join(f"{count} {name}" for name, count in self.outcomes.items())

    @property
    def turn_text(self) -> str:
        """The range of the true rotations in whole degrees, one number if both ends are equal."""
        ends = (min(self.turns_deg), max(self.turns_deg)) if self.turns_deg else ()
        return " to ".join(dict.fromkeys(f"{round(end) + 0:+d}" for end in ends)) or "-"

    def as_json(self) -> dict[str, object]:
        reacting = self.reacting
        reacted = {} if reacting is None else {"react": reacting.kind, "caught": reacting.caught}
        return {
            **reacted,
            "lifts_accepted": self.lifts_accepted,
            "lifts_refused": self.lifts_accepted - (self.mare.lifts if self.mare else 0),
            "mare_deg": self.mare and self.mare.mean_deg,
            "mare_std_deg": self.mare and self.mare.std_deg,
            "mare_interval_deg": self.mare and self.mare.ends_deg,
            "mare_b_deg": self.mare_b and self.mare_b.mean_deg,
            "mare_held_deg": self.mare_held and self.mare_held.mean_deg,
            "answered": self.answered,
            "bench_s": round(self.bench_s, 3),
        }


def summarize_trial(rows: Sequence[Lift]) -> TrialSummary:
    """Summarize the accepted lifts among the rows of a session; attempts that a fault ended are ignored."""
    lifts = accepted_lifts(rows)
    summary = summarize_lifts(lifts, sum(row.bench_s for row in rows))
    reacting = [lift for lift in lifts if lift.reactions is not None]
    if not reacting:
        return summary
    taken = [lift.reactions or () for lift in reacting]
    effect = ReactingSummary(
        kind=reacting[0].react.value,
        lifts=len(reacting),
        caught=sum(lift.outcome is LiftOutcome.CAUGHT for lift in reacting),
        reactions=sum(len(reactions) for reactions in taken),
        early=sum(reaction.onset_s is None for reactions in taken for reaction in reactions),
        added_counts=tuple(lift.counts_added or 0 for lift in reacting if lift.reactions),
        turns_deg=tuple(abs(t) for lift in reacting if (t := lift.final_truth_deg) is not None),
    )
    return replace(summary, reacting=effect)


def summarize_lifts(lifts: Sequence[Lift], bench_s: float = 0.0, name: str = "") -> TrialSummary:
    """Summarize lifts, and each of their objects unless `name` is that of the only one.

    bench_s: see `TrialSummary`.
    """
    by_object: dict[str, list[Lift]] = {}
    for lift in () if name else lifts:
        by_object.setdefault(lift.object, []).append(lift)
    return TrialSummary(
        name=name or "all",
        objects=tuple(summarize_lifts(own, name=own[0].label) for own in by_object.values()),
        lifts_accepted=len(lifts),
        outcomes=dict(Counter(str(lift.outcome) for lift in lifts)),
        mare=mare_of(lift.re for lift in lifts),
        mare_b=mare_of(lift.re_b for lift in lifts),
        mare_held=mare_of(lift.re_held for lift in lifts),
        answered=sum(lift.answered for lift in lifts) / max(len(lifts), 1),
        bench_s=bench_s,
        turns_deg=tuple(t for lift in lifts if (t := lift.final_truth_deg) is not None),
    )
