"""Openings by the counts of a Robotiq gripper, for tests that read its registers or count its steps."""

from drivers.interfaces import Gripper

OPEN_COUNTS = 6


def opening_m(gripper: Gripper, counts: float) -> float:
    """Return the opening in m that counts stand for; beyond the range as well."""
    return gripper.spec.opening_at(counts - OPEN_COUNTS)


def counts_of(gripper: Gripper) -> int:
    """Return the position in counts that the gripper reports."""
    return gripper.state().raw["position_counts"]
