"""What several scenarios need: sessions made once, and benches that hurry or take their time."""

from pathlib import Path

import pytest

from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.tactile.estimators import choose_estimator
from support.benches import lighter


@pytest.fixture(scope="session")
def unhurried_bench() -> BenchConfig:
    """The bench behind wires, made lighter.

    How fast the computer is, is not tested: `rig benchmark wire` and `rig benchmark faults`
    hold the whole bench to the limits.
    """
    bench = lighter("wire")
    near = (*bench.arm.home_m[:2], 0.17)  # the way from home and back is no part of a lift
    return bench.model_copy(update={"arm": bench.arm.model_copy(update={"home_m": near})})


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory, light_bench: BenchConfig) -> Path:
    """A trial of one simulated lift, to be read only."""
    folder = tmp_path_factory.mktemp("one_lift") / "trial"
    run_trial(folder, TrialSettings(light_bench, 0, choose_estimator("pca")), ["t2"], lifts=1)
    return folder
