"""A silent phase prints its name and its progress; a phase that prints something itself needs none."""

import io
import time

import pytest

from drivers.progress import steps
from rig.terminal.screen import begin_phase, end_phase, guarded_output


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.terminal.screen.SILENT_S", 0.2)


def test_a_silent_phase_prints_its_name_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with guarded_output():
        begin_phase("reading 3 lifts")
        time.sleep(1.0)
    assert capsys.readouterr() == ("", "reading 3 lifts ...\n")


def test_other_output_replaces_the_phase_name(capsys: pytest.CaptureFixture[str]) -> None:
    with guarded_output():
        begin_phase("loading")
        begin_phase("reading 3 lifts")
        print("result")
        begin_phase("writing the report")
    end_phase(wait=True)
    time.sleep(1.0)
    assert capsys.readouterr() == ("result\n", "")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def slowly(count: int, step_s: float = 0.1) -> None:
    for _ in steps(range(count)):
        time.sleep(step_s)


def test_progress_is_printed_as_lines_away_from_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.terminal.screen.PLAIN_EVERY_S", 0.5)
    with guarded_output():
        begin_phase("estimating with slip")
        slowly(15)
    out, err = capsys.readouterr()
    first, *others = err.splitlines()
    assert (out, first) == ("", "estimating with slip ...")
    assert 1 <= len(others) <= 3
    assert all(line.startswith("estimating with slip: ") and " of 15, " in line for line in others)
    assert "\r" not in err


def test_progress_updates_one_line_with_the_remaining_time_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rig.terminal.screen.PROGRESS_S", 0.5)
    monkeypatch.setattr("sys.stderr", screen := Terminal())
    begin_phase("rendering the film")
    slowly(20)
    end_phase(wait=True)
    shown = screen.getvalue().splitlines(keepends=True)
    assert shown[0] == "rendering the film ...\n"
    updates = "".join(shown[1:]).split("\r")
    assert any("of 20, about " in update and update.endswith(" s left\x1b[K") for update in updates)
    assert updates[-1] == "\x1b[K", "the line is removed at the end"


def test_progress_is_cut_to_the_width_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.terminal.screen.PROGRESS_S", 0.3)
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setattr("sys.stderr", screen := Terminal())
    begin_phase("rendering the film of a long lift")
    time.sleep(1.0)
    end_phase(wait=True)
    assert "\rrendering the film \x1b[K" in screen.getvalue()


def test_phase_without_steps_prints_the_elapsed_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.terminal.screen.PLAIN_EVERY_S", 0.5)
    with guarded_output():
        begin_phase("writing the page")
        time.sleep(1.2)
    assert "writing the page: 1 s so far" in capsys.readouterr().err


def test_phase_without_thread_prints_when_a_step_is_counted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.terminal.screen.PLAIN_EVERY_S", 0.4)
    with guarded_output():
        begin_phase("reading the sessions", ticking=False)
        time.sleep(0.5)
        assert capsys.readouterr().err == ""
        slowly(10)
    assert "reading the sessions: " in capsys.readouterr().err


def test_steps_are_not_printed_without_a_phase(capsys: pytest.CaptureFixture[str]) -> None:
    slowly(3)
    assert capsys.readouterr() == ("", "")
