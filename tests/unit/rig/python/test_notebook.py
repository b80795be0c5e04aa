"""The example notebook runs from the top, as it lies in the documentation."""

import shutil
from pathlib import Path

import pytest

from support.notebook import run_notebook

STORED = Path(__file__).resolve().parents[3] / "data" / "stored_trial"


@pytest.mark.heavy
@pytest.mark.parametrize("is_named", [False, True], ids=["its session", "named session"])
def test_example_notebook_runs(is_named: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    named = shutil.copytree(STORED, tmp_path / "named") if is_named else None
    shown = run_notebook(named)
    assert "SIMULATED" in repr(shown[1])
    assert ("named" in repr(shown[1])) == is_named
    assert shown[-2] >= {"tracking"}
    assert shown[-1].frames > 10
    out = capsys.readouterr().out
    assert "toothbrush: slipped, mean error 1.05 deg" in out
    assert "answered; last image angle" in out
