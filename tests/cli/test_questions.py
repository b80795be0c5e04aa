"""Questions at a terminal stay completely visible while displays are redrawn."""

import sys
from collections.abc import Callable
from typing import Any

import pytest

AtTerminal = Callable[[list[str], int], Any]
LATE_S = 1.2
"""Several redraws of a display, which come four times a second."""

IN_TRIAL = """if True:
    import tempfile
    from types import SimpleNamespace
    from rig.cli.common import stop_on_signals
    from rig.terminal.questions import ask
    from rig.live.feed import Inbox, Listener, Sender
    from rig.live.trial_view import TrialView
    stop_on_signals()
    inbox = Inbox(tempfile.mktemp())
    sender = Sender([Listener(inbox.address, False)])
    lift = {"number": 1, "object": "t1", "name": "wrench", "lift": 1, "sender": 7}
    sender.send("phase", {**lift, "phase": "A", "time_ns": 1})
    with TrialView(5, inbox, lambda row: "a lift") as view:
        view(1, 5, SimpleNamespace(number=9))
        %s
"""
IN_RECORD = """if True:
    from rig.cli.common import stop_on_signals
    from rig.terminal.questions import ask
    from rig.terminal.progress import WorkProgress
    stop_on_signals()
    with WorkProgress(15, "poses") as bar:
        bar.show(1, 15, "left at +15 deg: 15 images, 0 frames rejected")
        %s
"""
ASKED = """
        first = ask("Place object t1 (wrench) on its mark. Ready?")
        second = ask("Activate it now? Its fingers sweep their range.")
        print("answered", first, second, flush=True)
"""


@pytest.mark.heavy
@pytest.mark.parametrize("columns", [80, pytest.param(160, marks=pytest.mark.heavy)])
@pytest.mark.parametrize("code", [IN_TRIAL, IN_RECORD], ids=["trial", "record"])
def test_displays_are_hidden_until_a_question_is_answered(
    at_terminal: AtTerminal, code: str, columns: int
) -> None:
    terminal = at_terminal([sys.executable, "-c", code % ASKED], columns)
    for question, answer in (("Place object t1 (wrench) on its mark. Ready?", "y\n"), ("Activate it", "n\n")):
        terminal.wait_for(question)
        terminal.read_for(LATE_S)
        assert question in terminal.last(), terminal.text()
        assert terminal.last().endswith("[y/N]:")
        terminal.type(answer)
    terminal.wait_for("answered True False")


def test_log_of_a_session_has_question_and_answer(at_terminal: AtTerminal) -> None:
    code = """if True:
    import logging
    from rig.terminal.questions import ask
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    ask("Ready?")
"""
    terminal = at_terminal([sys.executable, "-c", code], 80)
    terminal.wait_for("Ready? [y/N]:")
    terminal.type("y\n")
    terminal.wait_for("INFO Ready? [y/N]: answered: y")


@pytest.mark.heavy
def test_keys_typed_before_the_question_do_not_answer_it(at_terminal: AtTerminal) -> None:
    code = """
        import time
        print("busy", flush=True)
        time.sleep(1.0)
        print("answered", ask("Shall the fingers open?"), flush=True)
"""
    terminal = at_terminal([sys.executable, "-c", IN_TRIAL % code], 80)
    terminal.wait_for("busy")
    terminal.type("y\ny\n")
    terminal.wait_for("Shall the fingers open?")
    terminal.read_for(0.5)
    assert "answered" not in terminal.text()
    terminal.type("maybe\n")
    terminal.wait_for("neither")
    terminal.read_for(0.5)
    terminal.wait_for("Shall the fingers open? [y/N]:")
    terminal.type("\n")
    terminal.wait_for("answered False")


def test_question_without_a_terminal_counts_as_refused(at_terminal: AtTerminal, tmp_path: Any) -> None:
    code = (
        "import sys; sys.stderr = open({!r}, 'w'); from rig.terminal.questions import ask; print(ask('Go?'))"
    )
    terminal = at_terminal([sys.executable, "-c", code.format(str(tmp_path / "log"))], 80)
    terminal.type("y\n")
    terminal.wait_for("False")
    assert "no terminal" in (tmp_path / "log").read_text()


@pytest.mark.heavy
def test_end_of_input_confirms_no_place_of_the_tip(at_terminal: AtTerminal) -> None:
    code = """if True:
    from rig.bench.operators import ConsoleOperator
    from rig.terminal.questions import ask, ask_line
    print("answered", ConsoleOperator(ask, tell=ask_line).nudge("How far must the tip move?"), flush=True)
"""
    terminal = at_terminal([sys.executable, "-c", code], 80)
    terminal.wait_for("q to stop:")
    terminal.type("\x04")
    terminal.wait_for("the input ended without an answer")
    assert "answered" not in terminal.text()
