"""What several scenarios need: sessions made once, and a bench and a computer fit for real time."""

import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from drivers.errors import CalibrationError, DeviceError
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.trial import run_trial
from rig.tactile.estimators import choose_estimator


def _with_half_the_frames(bench: BenchConfig) -> BenchConfig:
    slower = tuple(tactile.model_copy(update={"rate_hz": 30.0}) for tactile in bench.tactile)
    return bench.model_copy(update={"tactile": slower})


@pytest.fixture(scope="session")
def light_bench() -> BenchConfig:
    """The simulated bench with its fingertips at half their rate: lifts are done in half the time."""
    return _with_half_the_frames(load_bench("fake"))


@pytest.fixture(scope="session")
def unhurried_bench() -> BenchConfig:
    """The bench behind wires with its fingertips at half their rate: how fast the computer is, is not tested.

    At full rates `rig benchmark wire` and `rig benchmark faults` hold it to the limits.
    """
    return _with_half_the_frames(load_bench("wire"))


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory, light_bench: BenchConfig) -> Path:
    """A trial of one simulated lift, to be read only."""
    folder = tmp_path_factory.mktemp("one_lift") / "trial"
    run_trial(folder, TrialSettings(light_bench, 0, choose_estimator("pca")), ["t2"], lifts=1)
    return folder


MOST_LATE_S = 0.05
"""Later than this nobody on the computer keeps the deadlines of an arm and of 60 frames a second."""
LATENESS = (DeviceError, AssertionError, pytest.fail.Exception)
"""What a computer without time can cause: a device that was not heard, a count that falls short."""
WAKING = """
import select, sys, time
late, due = 0.0, time.monotonic()
while True:
    due += 0.01
    if select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
        break
    late, due = max(late, time.monotonic() - due), max(due, time.monotonic())
print(late)
"""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Connect in time, or skip."""
    return (yield from _in_time(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Run in time, or skip."""
    return (yield from _in_time(item))


def _in_time(item: pytest.Item) -> Generator[None]:
    """Go on with a test marked `real_time`; where it is too late as the computer stood still, skip it.

    Whether it stood still is seen by a process that does nothing but wake every 10 ms. What no
    standing still explains, as a calibration refused, fails all the same.
    """
    if item.get_closest_marker("real_time") is None:
        return (yield)
    command = [sys.executable, "-c", WAKING]
    waking = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        return (yield)
    except (Exception, pytest.fail.Exception) as failure:
        late_s = float(waking.communicate("\n", timeout=30)[0])
        of_lateness = isinstance(failure, LATENESS) and CalibrationError.__name__ not in str(failure)
        if late_s <= MOST_LATE_S or not of_lateness:
            raise
        pytest.skip(
            f"real time needs a computer with time: this one stood still for {late_s:.2f} s ({failure})"
        )
    finally:
        waking.kill()
        waking.communicate()
