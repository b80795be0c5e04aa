"""A bench over the wire protocols that a loaded host can keep up with."""

import pytest

from rig.config import BenchConfig
from support.benches import lighter
from support.marks import require_ur_rtde


@pytest.fixture(scope="session")
def unhurried_bench() -> BenchConfig:
    """The bench behind wires, made lighter.

    How fast the computer is, is not tested: `rig benchmark wire` and `rig benchmark safety`
    hold the whole bench to the limits.
    """
    require_ur_rtde()
    bench = lighter("wire")
    near = (*bench.arm.home_m[:2], 0.17)  # the way from home and back is no part of a lift
    return bench.model_copy(update={"arm": bench.arm.model_copy(update={"home_m": near})})
