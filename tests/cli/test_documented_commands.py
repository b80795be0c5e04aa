"""Command lines in README and docs parse, with their options, as the program itself parses them."""

import re
import shlex
from pathlib import Path

import pytest

from support.command_line import rig
from support.documentation import PAGES, ROOT, USAGE_ERROR, code_lines, commands, parse, script, spans

COMMANDS_PAGE = ROOT / "docs" / "commands.md"
FIRST_LIFT_PAGE = ROOT / "docs" / "first_lift_simulated.md"
TRY_IT = script("try_it")
QUICK = re.compile(r"rig (objects|new|bench (new|udev)|calibrate board|estimators|model list)\b")
"""Commands of about a second."""


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_every_command_line_parses(page: Path) -> None:
    try:
        for line in code_lines(page):
            parse(line)
        for line in spans(page):
            parse(line, may_be_a_name=True)
    except USAGE_ERROR as error:
        pytest.fail(f"{page.name}: {line}: {error}")


def test_command_lines_are_found() -> None:
    found = {page.name: len(code_lines(page)) for page in PAGES}
    assert sum(count > 0 for count in found.values()) > len(PAGES) / 2, found


@pytest.mark.heavy
def test_every_command_is_on_the_commands_page() -> None:
    named = {parse(line, may_be_a_name=True) for line in spans(COMMANDS_PAGE)}
    assert set(commands()) <= named


@pytest.mark.parametrize(
    "line",
    [
        "rig label-angle a --nope",
        "rig estimat x",
        "rig bench new",
        "rig label-angle",
        "rig play --lift 1",
        "rig nope",
    ],
)
def test_parser_rejects_wrong_command_lines(line: str) -> None:
    with pytest.raises(USAGE_ERROR):
        parse(line)


def quick_lines(page: Path) -> list[str]:
    """The quick lines of a page that need no hardware and no file of the reader."""
    lines = (line for line in TRY_IT.command_lines(long=False) if line.page == page.name)
    return [line.text for line in lines if QUICK.match(line.text) and not line.why_not]


@pytest.mark.parametrize("page", [p for p in PAGES if quick_lines(p)], ids=lambda page: page.name)
def test_quick_lines_of_a_page_run_in_an_empty_folder(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for line in quick_lines(page):
        done = rig(*shlex.split(line)[1:])
        assert done.returncode == 0, f"{line}: {done.stderr}"


@pytest.mark.heavy
def test_first_lift_prints_what_its_page_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = FIRST_LIFT_PAGE.read_text(encoding="utf-8")
    shown = re.findall(r"^```text\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)[0].splitlines()
    monkeypatch.chdir(tmp_path)
    done = rig(*shlex.split(code_lines(FIRST_LIFT_PAGE)[0])[1:])
    printed = (done.stdout + done.stderr).splitlines()
    assert done.returncode == 0
    assert [line for line in shown if line not in printed] == []
