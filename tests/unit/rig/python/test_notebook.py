"""The example notebook runs from the top, as it lies in the documentation."""

import pytest

from support.notebook import run_notebook


@pytest.mark.heavy
def test_example_notebook_runs(capsys: pytest.CaptureFixture[str]) -> None:
    shown = run_notebook()
    assert "SIMULATED" in repr(shown[1])
    assert shown[-2] >= {"tracking"}
    assert shown[-1].frames > 10
    out = capsys.readouterr().out
    assert "toothbrush: slipped, mean error 1.05 deg" in out
    assert "answered; last image angle" in out
