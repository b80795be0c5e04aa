"""Child processes import nothing from the current folder and leave the terminal's signals to their parent."""

import os
import signal
import sys

import pytest

from drivers.children import FROM_TERMINAL, SAFE_PATH, leave_signals_to_parent, python_command, spawn_context


def is_safe(_: object = None) -> bool:
    return bool(sys.flags.safe_path)


def ignored() -> list[bool]:
    leave_signals_to_parent()
    return [signal.getsignal(number) is signal.SIG_IGN for number in FROM_TERMINAL]


def put(pipe: object, what: object) -> None:
    pipe.send(what())  # type: ignore[attr-defined, operator]


def in_child(what: object) -> object:
    context = spawn_context()
    ours, theirs = context.Pipe()
    process = context.Process(target=put, args=(theirs, what))
    process.start()
    try:
        assert ours.poll(60.0)
        return ours.recv()
    finally:
        process.join()


@pytest.mark.heavy
def test_spawned_process_has_a_safe_path_and_other_programs_keep_their_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(SAFE_PATH, raising=False)
    assert in_child(is_safe) is True
    assert SAFE_PATH not in os.environ
    monkeypatch.setenv(SAFE_PATH, "yes")
    assert in_child(is_safe) is True
    assert os.environ[SAFE_PATH] == "yes"


def test_command_line_has_the_option_for_a_safe_path_and_a_child_ignores_signals_of_the_terminal() -> None:
    assert python_command("-m", "rig", 2) == [sys.executable, "-P", "-m", "rig", "2"]
    assert in_child(ignored) == [True] * 3


@pytest.mark.heavy
def test_pool_ends_its_own_workers_only() -> None:
    from rig.experiments.process_pool import run_tasks

    context = spawn_context()
    ours, theirs = context.Pipe()
    other = context.Process(target=theirs.recv)
    other.start()
    assert all(safe for _, safe in run_tasks(is_safe, [1, 2, 3], jobs=2))
    ours.send("end")
    other.join(30)
    assert other.exitcode == 0, "it ran until it was told to end"
