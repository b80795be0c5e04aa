"""Check before anything moves whether a trial may react to slip."""

from collections.abc import Iterable

from drivers.errors import InputError
from protocols.grasps import find_grasp_file
from protocols.reaction import FIRST_CLOSING_M, MOST_REACTIONS, ReactionKind
from rig.experiments.lift_plan import TrialSettings
from rig.lift.tip_watch import sigmas_for
from rig.tactile.estimators import WITH_RATE


def require_reaction(settings: TrialSettings, objects: Iterable[str]) -> None:
    """Raise `InputError` if a trial cannot or may not react, because of bench, estimator, rate or object."""
    if settings.react is ReactionKind.NONE:
        return
    bench, estimator = settings.bench, settings.estimator.name
    if not bench.reacts:
        raise InputError(
            f"--react {settings.react}: bench '{bench.name}' does not permit it: the arm would stop and the "
            "fingers would close automatically; if that is safe, write reactions_allowed = true in its file"
        )
    if estimator not in WITH_RATE:
        raise InputError(
            f"--react {settings.react}: estimator '{estimator}' estimates no angular rate, so no slip "
            f"in time; use {', '.join(WITH_RATE)}"
        )
    for tactile in bench.tactile:
        sigmas_for(settings.slip.false_alarms_per_hour / len(bench.tactile), tactile.rate_hz)
    if settings.react is ReactionKind.TIGHTEN:
        for object_id in objects:
            find_grasp_file(object_id, bench.objects).require_largest_grip()


def describe_reaction(settings: TrialSettings, objects: Iterable[str]) -> list[str]:
    """Return lines that describe a trial's reaction to slip; none without a reaction."""
    if settings.react is ReactionKind.NONE:
        return []
    limit = settings.slip.max_turn_deg
    when = "" if limit is None else f" that would rotate the object by more than {limit:g} degrees"
    head = f"On a slip{when} the arm stops automatically, at most {MOST_REACTIONS} times per lift,"
    if settings.react is ReactionKind.STOP:
        return [f"{head} and holds the object there."]
    if settings.react is ReactionKind.LOWER:
        return [f"{head} and sets the object down."]
    grasps = [find_grasp_file(object_id, settings.bench.objects) for object_id in objects]
    largest = ", ".join(f"{g.id} {g.name} {1e3 * g.require_largest_grip():.1f}" for g in grasps)
    return [
        f"{head} the fingers close step by step ({1e3 * FIRST_CLOSING_M:.1f} mm, then twice as far each "
        f"time), and the lift goes on. At most, in mm past contact: {largest}."
    ]
