"""A pointed tip in the simulated hand and a small hole on the table: for finding the tip by pivoting."""

import numpy as np

from drivers.types import Pose, Vector3

_TIP_M = (0.0021, -0.0014, 0.0320)
_TIP_SPREAD_M = 0.002
_HOLE_FROM_TABLE_M = (0.02, 0.03, 0.0)


def tip_m(seed: int) -> Vector3:
    """Where the tip is in the TCP's frame: clamped by hand, so different for each seed."""
    x, y, z = (float(v) for v in np.random.default_rng((seed, 41)).normal(_TIP_M, _TIP_SPREAD_M))
    return x, y, z


def gap_m(base_T_tcp: Pose, base_T_table: Pose, seed: int) -> Vector3:  # noqa: N803
    """From the tip to the bottom of the hole, along the base's axes: what a person beside it sees."""
    tip = base_T_tcp.rotation.apply(tip_m(seed)) + np.asarray(base_T_tcp.position_m)
    x, y, z = (float(v) for v in np.add(base_T_table.position_m, _HOLE_FROM_TABLE_M) - tip)
    return x, y, z
