"""How far a contact can have turned while nobody saw it."""

import math

# A held object that begins to slip, or one turned by hand, changes its rate at most so fast, one sigma.
ACCELERATION_RAD_S2 = math.radians(300.0)
# Beyond this nothing is known: all turns within a half turn to either side are as likely.
ANY_TURN_RAD = math.pi / math.sqrt(12.0)


def unseen_variance(rate_rad_s: float, elapsed_s: float) -> float:
    """Return the variance of a turn that was not seen, rad^2: what the last rate leaves open.

    rate_rad_s: as last seen; the object may have stopped or gone on. elapsed_s: since then.
    """
    speed = abs(rate_rad_s) + 0.5 * ACCELERATION_RAD_S2 * elapsed_s
    return min(speed * elapsed_s, ANY_TURN_RAD) ** 2
