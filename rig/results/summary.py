"""Summarize trials: a table per object, MARE with intervals, advice on refused frames."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from rig.results.metrics import Mare, mare_of
from rig.sessions.records import Lift, LiftOutcome, finished

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
class ObjectSummary:
    """One object's row of the table: lifts, outcomes, and MARE over B, and over B and C.

    turn_deg: smallest and largest true rotation; None if no lift has one.
    """

    object_id: str
    name: str
    lifts: int
    outcomes: dict[str, int]
    mare_b: Mare | None
    mare: Mare | None
    answered: float
    turn_deg: tuple[float, float] | None

    @property
    def turn_text(self) -> str:
        """The range of the true rotations in whole degrees, one number if both ends are equal."""
        ends = dict.fromkeys(f"{round(end) + 0:+d}" for end in self.turn_deg or ())
        return " to ".join(ends) or "-"


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
    """Summary of a trial. reacting: None unless lifts react to slip; their errors are listed separately."""

    objects: tuple[ObjectSummary, ...]
    lifts_accepted: int
    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    answered: float
    bench_s: float
    turns_deg: tuple[float, ...]
    reacting: ReactingSummary | None = None

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
    lifts = finished(rows)
    summary = summarize_lifts(lifts, sum(row.bench_s for row in rows))
    return replace(
        summary, reacting=_reacting_summary([lift for lift in lifts if lift.reactions is not None])
    )


def summarize_lifts(lifts: Sequence[Lift], bench_s: float) -> TrialSummary:
    """Summarize lifts. bench_s: total duration by the bench's clock, including failed attempts."""
    ids = list(dict.fromkeys(lift.object for lift in lifts))
    return TrialSummary(
        objects=tuple(_object_summary([lift for lift in lifts if lift.object == i]) for i in ids),
        lifts_accepted=len(lifts),
        mare=mare_of(lift.re for lift in lifts),
        mare_b=mare_of(lift.re_b for lift in lifts),
        mare_held=mare_of(lift.re_held for lift in lifts),
        answered=_mean([lift.answered for lift in lifts]),
        bench_s=bench_s,
        turns_deg=_turns(lifts),
    )


def _reacting_summary(lifts: Sequence[Lift]) -> ReactingSummary | None:
    if not lifts:
        return None
    taken = [lift.reactions or () for lift in lifts]
    return ReactingSummary(
        kind=lifts[0].react.value,
        lifts=len(lifts),
        caught=sum(lift.outcome is LiftOutcome.CAUGHT for lift in lifts),
        reactions=sum(len(reactions) for reactions in taken),
        early=sum(reaction.onset_s is None for reactions in taken for reaction in reactions),
        added_counts=tuple(sum(r.counts_added for r in reactions) for reactions in taken if reactions),
        turns_deg=tuple(abs(turn) for turn in _turns(lifts)),
    )


def _object_summary(lifts: Sequence[Lift]) -> ObjectSummary:
    turns = _turns(lifts)
    return ObjectSummary(
        object_id=lifts[0].object,
        name=lifts[0].name,
        lifts=len(lifts),
        outcomes=dict(Counter(str(lift.outcome) for lift in lifts)),
        mare_b=mare_of(lift.re_b for lift in lifts),
        mare=mare_of(lift.re for lift in lifts),
        answered=_mean([lift.answered for lift in lifts]),
        turn_deg=(min(turns), max(turns)) if turns else None,
    )


def _turns(lifts: Sequence[Lift]) -> tuple[float, ...]:
    """Return the final true angles, deg, of the lifts that have one."""
    return tuple(lift.final_truth_deg for lift in lifts if lift.final_truth_deg is not None)


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
