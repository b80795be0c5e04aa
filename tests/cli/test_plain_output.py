"""Control sequences in names, notes and tags of a foreign session do not act on the terminal."""

import json
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from support.command_line import refusal, rig
from support.marks import heavy

STORED = Path(__file__).parents[1] / "data" / "stored_trial"
CLEAR, OVERRIDE, C1, TITLE, LINK = "\x1b[2J", "\u202e", "\x9b31m", "\x1b]0;owned\x07", "[link=file:///etc]"
HOSTILE = f"é±測{CLEAR}{OVERRIDE}{C1}{TITLE}{LINK}[bold]\r"
ACTING = (CLEAR, OVERRIDE, C1, TITLE, "\x9b", "\x1b]")


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Return a trial with hostile texts in all free text fields of its files."""
    folder = tmp_path / "sessions" / "hostile[bold]"
    shutil.copytree(STORED, folder)
    change(folder / "session.json", bench=HOSTILE, started=HOSTILE, simulated=False, remarks={
        "name": HOSTILE, "note": HOSTILE, "tags": [HOSTILE], "operator": HOSTILE,
    })  # fmt: skip
    change(folder / "lifts.jsonl", name=f"wrench{OVERRIDE}\x9b[bold]", simulated=False)
    return folder


def change(file: Path, **values: Any) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | values) + "\n")


def at_a_terminal(*arguments: object) -> str:
    """Return the output of `rig ARGUMENTS` on a terminal, with all control sequences."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "rig", *map(str, arguments)]
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    written = b""
    try:
        while data := os.read(ours, 65536):
            written += data
    except OSError:  # the process has ended
        pass
    process.wait(60)
    os.close(ours)
    return written.decode("utf-8", "surrogateescape")


def commands(session: Path) -> dict[str, tuple[object, ...]]:
    return {
        "sessions": ("sessions", session.parent),
        "replay": ("replay", session, "--jobs", 1),
        "replays": ("replay", session, "--jobs", 1, "--out", session.parent / "again"),
        "play": ("play", session, "--lift", 1, "--out", session.parents[1] / "lift.webm"),
        "compare": ("compare", session, STORED, "--out", session.parents[1] / "page.html"),
        "report": ("report", session),
    }


NAMES = ("sessions", "replay", "compare", "report", "play", "replays")


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["sessions", *heavy(*NAMES[1:])])
def test_control_sequences_in_foreign_text_do_not_act_on_a_terminal(session: Path, name: str) -> None:
    written = at_a_terminal(*commands(session)[name])
    assert not [text for text in ACTING if text in written]


@pytest.mark.heavy
@pytest.mark.parametrize("name", [*NAMES[:4], *heavy(*NAMES[4:])])
def test_control_characters_in_foreign_text_are_escaped_in_other_output(session: Path, name: str) -> None:
    done = rig(*commands(session)[name])
    printed = done.stdout + done.stderr
    assert not [c for c in printed if c != "\n" and (not c.isprintable() or c in OVERRIDE)]


def test_json_output_contains_texts_unchanged_but_escaped(session: Path) -> None:
    printed = rig("sessions", session.parent, "--json").stdout
    assert printed.isascii()
    assert printed.strip().isprintable()
    assert json.loads(printed)["sessions"][0]["name"] == HOSTILE


def test_errors_show_paths_plainly(tmp_path: Path) -> None:
    assert "none\\u001b[2J\\u202e" in refusal("report", tmp_path / f"none{CLEAR}{OVERRIDE}")
