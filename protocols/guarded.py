"""Motions that end where the hand meets something: wrench and gripper are watched on the way down."""

import numpy as np

from drivers.bench import Bench
from drivers.errors import ContactForceError
from drivers.interfaces import Motion
from drivers.motion import PolledMotion
from drivers.types import ArmState, Holding


def guarded(bench: Bench, motion: Motion, before: ArmState) -> Motion:
    """Return a motion of the arm that stops where the force has changed by more than the arm's limit.

    before: the arm as it stood when the motion began; what its sensor is off by, and what hangs in the
    fingers, is in that force too. Asked for its end, the motion raises `ContactForceError` once stopped, and
    what the gripper raises that is lost; where it holds something, that is set down all the same.
    """
    limit_n = bench.arm.limits.max_contact_force_n

    def has_ended() -> bool:
        state = bench.arm.state()
        change_n = float(np.linalg.norm(np.subtract(state.wrench[:3], before.wrench[:3])))
        if change_n > limit_n:
            bench.arm.stop()
            x, y, z = state.base_T_tcp.position_m
            raise ContactForceError(
                f"arm: met something on its way down at ({x:.3f}, {y:.3f}, {z:.3f}) m: the force changed by "
                f"{change_n:.0f} N (max_contact_force_n {limit_n:g}); it was stopped. See what is in the "
                "way, and that the table's and the object's heights in the bench file are right"
            )
        if bench.hand.state.holding is not Holding.HELD:
            bench.gripper.state()
        return motion.done()

    return PolledMotion("arm", bench.clock, has_ended, bench.arm.stop)
