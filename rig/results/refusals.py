"""Why frames have no angle, and what to do about it."""

from collections import Counter
from collections.abc import Iterable, Mapping

ADVICE = {
    "unobservable": "Such a contact looks the same however it turns: grasp it elsewhere or at an edge.",
    "lost": "The picture changed more than a turn can: look at the frames for stray light, a new contact or "
    "a finger that moved.",
    "no_contact": "The fingertip felt nothing: grip firmer, or see whether the object slid out.",
}
"""By the states without an angle."""


def main_refusal(states: Iterable[Mapping[str, int]]) -> str:
    """Return the state without an angle that most frames have; "lost" if there is none.

    states: frames by state, for each lift.
    """
    counts: Counter[str] = Counter()
    for lift in states:
        counts.update({state: n for state, n in lift.items() if state in ADVICE and n})
    return counts.most_common(1)[0][0] if counts else "lost"
