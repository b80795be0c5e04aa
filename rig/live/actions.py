"""The actions that the page of `rig live` offers and that its desk carries out; all others are refused."""

from collections.abc import Sequence

REFERENCE, TAKE_BACKGROUND, RECORD, ESTIMATOR = "reference", "background", "record", "estimator"
"""Actions that the user can request; `estimator` is followed by a name."""


def offered_actions(estimators: Sequence[str]) -> frozenset[str]:
    """Return the actions of a page with these estimators."""
    return frozenset((REFERENCE, TAKE_BACKGROUND, RECORD, *(f"{ESTIMATOR} {name}" for name in estimators)))
