"""Where the tool centre point must not go: boxes, and straight ways that would lead through them."""

from collections.abc import Sequence
from itertools import pairwise

from drivers.errors import OutOfLimitsError
from drivers.types import ArmLimits, Box, Pose, Vector3

UPRIGHT_M = 1e-3
"""A way whose ends are no further apart across leads straight up or down."""


def check_way(limits: ArmLimits, way: Sequence[Pose]) -> None:
    """Raise `OutOfLimitsError` where a way, straight from pose to pose, leads through a box of `limits`.

    From inside a box the only way that is not refused is the one straight up.
    """
    for here, there in pairwise(pose.position_m for pose in way):
        for box in limits.keep_out:
            if meets(box, here, there) and not (_inside(box, here) and _straight_up(here, there)):
                raise OutOfLimitsError(
                    f"arm: the way from {_text(here)} to {_text(there)} m leads the hand into '{box.name}', "
                    "which the bench file keeps it out of; see [[keep_out]], top_m of [table], and where the "
                    "object lies"
                )


def meets(box: Box, here: Vector3, there: Vector3) -> bool:
    """Whether the straight line between two points has a point inside a box; its surface is outside."""
    enters, leaves = 0.0, 1.0
    for a, b, low, high in zip(here, there, box.min_m, box.max_m, strict=True):
        if a == b:
            if not low < a < high:
                return False
            continue
        first, last = sorted(((low - a) / (b - a), (high - a) / (b - a)))
        enters, leaves = max(enters, first), min(leaves, last)
    return enters < leaves


def _straight_up(here: Vector3, there: Vector3) -> bool:
    across = max(abs(here[0] - there[0]), abs(here[1] - there[1]))
    return across <= UPRIGHT_M and there[2] > here[2]


def _inside(box: Box, point: Vector3) -> bool:
    return all(low < v < high for low, v, high in zip(box.min_m, point, box.max_m, strict=True))


def _text(point: Vector3) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in point) + ")"
