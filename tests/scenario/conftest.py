"""What several scenarios look at: sessions made once."""

from pathlib import Path

import pytest

from rig.attempt import TrialSettings
from rig.config import load_bench
from rig.tactile.estimator import choose_estimator
from rig.trial import run_trial


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one simulated lift, to be read only."""
    folder = tmp_path_factory.mktemp("one_lift") / "trial"
    run_trial(folder, TrialSettings(load_bench("fake"), 0, choose_estimator("pca")), ["t2"], lifts=1)
    return folder
