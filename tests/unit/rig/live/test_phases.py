"""The name of a silent phase is printed; a phase that prints something itself needs none."""

import time

import pytest

from rig.live.output import guarded_output
from rig.live.screen import begin_phase, end_phase


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.live.screen.SILENT_S", 0.2)


def test_a_silent_phase_prints_its_name_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with guarded_output():
        begin_phase("reading 3 lifts")
        time.sleep(1.0)
    assert capsys.readouterr() == ("", "reading 3 lifts ...\n")


def test_other_output_replaces_the_phase_name(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with guarded_output():
        begin_phase("loading")
        begin_phase("reading 3 lifts")
        print("result")
        begin_phase("writing the report")
    end_phase(wait=True)
    time.sleep(1.0)
    assert capsys.readouterr() == ("result\n", "")
