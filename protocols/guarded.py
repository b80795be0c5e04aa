"""Downward motions that stop at contact: force and gripper are monitored.

The constructors of the states reject NaN and other invalid values (`drivers.types`), and their error stops
the motion; so no comparison here is false because of NaN.
"""

import numpy as np

from drivers.bench import Bench
from drivers.errors import ContactForceError
from drivers.interfaces import Arm, Motion
from drivers.motion import PolledMotion
from drivers.types import ArmState, Holding


def guarded(bench: Bench, motion: Motion, before: ArmState) -> Motion:
    """Return a motion of the arm that stops if the force changes by more than the arm's limit.

    An arm without a force sensor (no `max_contact_force_n`) is not stopped at contact; the plan states that.

    before: state of the arm when the motion began; its force includes the sensor's offset and the weight of
    an object in the fingers. `done` stops the arm and raises `ContactForceError`. It raises the error of a
    lost gripper, unless the hand holds an object: that is set down in any case.
    """
    limit_n = bench.arm.limits.max_contact_force_n

    def has_ended() -> bool:
        state = bench.arm.state()
        if limit_n is not None:
            _require_no_contact(bench.arm, before, state, limit_n)
        if bench.hand.state.holding is not Holding.HELD:
            bench.gripper.state()
        return motion.done()

    return PolledMotion("arm", bench.clock, has_ended, bench.arm.stop)


def _require_no_contact(arm: Arm, before: ArmState, now: ArmState, limit_n: float) -> None:
    change_n = float(np.linalg.norm(np.subtract(now.force_n, before.force_n)))
    if change_n <= limit_n:
        return
    arm.stop()
    x, y, z = now.base_T_tcp.position_m
    raise ContactForceError(
        f"arm: met an obstacle on its way down at ({x:.3f}, {y:.3f}, {z:.3f}) m: the force changed by "
        f"{change_n:.0f} N (max_contact_force_n {limit_n:g}); it was stopped. Check what is in the "
        "way, and that the table's and the object's heights in the bench file are right"
    )
