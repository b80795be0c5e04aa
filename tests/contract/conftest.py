"""One suite per interface. Today it runs on the simulated devices; further ones join `KINDS`."""

from collections.abc import Iterator

import pytest

from drivers.bench import Bench
from rig.assembly import build_bench
from rig.config import load_bench

KINDS = ("fake",)


@pytest.fixture(params=KINDS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A connected bench with an object in its place and the gripper activated."""
    bench, operator = build_bench(load_bench(request.param), seed=7)
    with bench.connected():
        operator.place("t1", "wrench")
        bench.gripper.activate()
        yield bench
