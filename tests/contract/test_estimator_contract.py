"""Contract checks of the rig's estimators and of a user-defined one."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.contract_checks import MakeEstimator, TestEstimator  # noqa: F401
from rig.tactile.estimators import ESTIMATORS, PUBLISHED, TOSKOV, choose_estimator
from support.own_estimators import MODULE, own_estimators

OWN = f"{MODULE}:Mine"
NAMES = [name for name in ESTIMATORS if name != TOSKOV]
"""Toskov's network asks for the arm's states too."""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with own_estimators(tmp_path_factory.mktemp("lab")) as imported:
        yield imported


@pytest.fixture(
    params=[*(pytest.param(n, marks=pytest.mark.heavy) if PUBLISHED in n else n for n in NAMES), OWN]
)
def make_estimator(request: pytest.FixtureRequest) -> MakeEstimator:
    if request.param == OWN:
        request.getfixturevalue("own")
    return choose_estimator(request.param).make
