"""Command lines in README and docs parse, with their options, as the program itself parses them."""

from pathlib import Path

import pytest

from support.documentation import PAGES, ROOT, USAGE_ERROR, code_lines, commands, parse, spans

COMMANDS_PAGE = ROOT / "docs" / "commands.md"


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


def test_every_command_stands_on_the_page_of_commands() -> None:
    named = {parse(line, may_be_a_name=True) for line in spans(COMMANDS_PAGE)}
    assert set(commands()) <= named


@pytest.mark.parametrize(
    "line",
    [
        "rig label-angle a --nope",
        "rig estimat x",
        "rig bench new",
        "rig label-angle",
        "rig play a --lift 1",
        "rig nope",
    ],
)
def test_a_wrong_one_would_be_seen(line: str) -> None:
    with pytest.raises(USAGE_ERROR):
        parse(line)


def test_lines_are_found_in_blocks_and_in_the_text(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```sh\nrig trial \\\n    --lifts 1  # once\n```\n\nand `rig label-angle`\n")
    assert code_lines(page) == ["rig trial --lifts 1  # once"]
    assert spans(page) == ["rig label-angle"]
