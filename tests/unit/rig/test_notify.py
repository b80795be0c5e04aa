"""The command of `--notify` gets the event as arguments, has a time limit, and fails with one warning."""

import json
import shlex
import sys
import time
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.live.notify import Notifier
from rig.live.onlookers import Event, looking_on

KEEPS = "import json, sys; print(json.dumps(sys.argv[2:]), file=open(sys.argv[1], 'a'))"


def keeping(file: Path) -> str:
    return shlex.join([sys.executable, "-c", KEEPS, str(file)])


def kept(file: Path) -> list[list[str]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_event_text_is_passed_without_a_shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    odd = "$(touch x); \" `touch y` ' \n-z * ü"
    warnings: list[str] = []
    with Notifier(keeping(tmp_path / "kept"), warnings.append, 60.0) as notifier, looking_on(notifier.tell):
        for event in (Event("fault", odd), Event("progress", "1 of 2"), Event("question", "a\0b")):
            notifier.tell(event)
    assert kept(tmp_path / "kept") == [["fault", odd], ["question", "a b"], ["end", "done"]]
    assert {path.name for path in tmp_path.iterdir()} == {"kept"}
    assert warnings == []


@pytest.mark.parametrize(
    ("command", "longest_s", "why"),
    [("sh -c 'exit 3'", 60.0, "it ended with 3"), ("sh -c 'sleep 600'", 0.5, "it took longer than 0.5 s")],
)
def test_failing_or_hanging_command_is_warned_of_once(command: str, longest_s: float, why: str) -> None:
    warnings: list[str] = []
    with Notifier(command, warnings.append, longest_s) as notifier:
        notifier.tell(Event("fault", "one"))
        notifier.tell(Event("fault", "two"))
        while not warnings:  # what hangs for as long as it likes ends at the suite's own limit
            time.sleep(0.01)
    assert len(warnings) == 1
    assert why in warnings[0]


def test_events_beyond_the_queue_are_dropped_with_a_warning(tmp_path: Path) -> None:
    warnings: list[str] = []
    with Notifier("sh -c 'sleep 600'", warnings.append, longest_s=2.0) as notifier:
        for _ in range(100):
            notifier.tell(Event("fault", "again"))
    assert len(warnings) == 1
    assert "slower than the events" in warnings[0]


@pytest.mark.parametrize(
    ("command", "why"),
    [("", "no such program"), ("no-such-command-here a", "no such program"), ('a "b', "quotes")],
)
def test_invalid_command_is_rejected_first(command: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        Notifier(command, print)
