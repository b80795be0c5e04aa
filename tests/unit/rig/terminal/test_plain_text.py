"""Characters that are escaped, and control sequences of rich that are kept."""

import io
import json
import sys

import pytest
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rig.terminal.screen import PlainStream, plain, set_aside, show_display
from rig.terminal.tables import PlainConsole


@pytest.mark.parametrize(
    "text", ["é ± 測定 – ° µ", "क्‍ष", "👩‍🔧", "a\tb\nc", "a\r\nb", "עברית", "[bold]", ":x:"]
)
def test_legitimate_text_is_kept(text: str) -> None:
    assert plain(text) == text


@pytest.mark.parametrize("code", [*range(9), 0x0B, 0x0D, 0x1B, 0x7F, 0x85, 0x9B, 0x9D, 0x61C, 0x200E, 0x202A,
                                  0x202E, 0x2028, 0x2066, 0x2069, 0xFEFF, 0xDC80])  # fmt: skip
def test_acting_characters_are_shown_as_json_escapes(code: int) -> None:
    assert plain(f"a{chr(code)}b") == f"a\\u{code:04x}b"
    assert json.loads(plain(f'"a{chr(code)}b"')) == f"a{chr(code)}b"


def test_tag_characters_are_shown_as_escapes() -> None:
    assert plain("\U000e0041") == "\\U000e0041"


def test_console_keeps_its_own_sequences_and_reads_no_markup() -> None:
    stream = io.StringIO()
    console = PlainConsole(file=stream, force_terminal=True, color_system="standard", width=80)
    table = Table(title="[red]title :x:")
    table.add_row("[bold]a\x1b[8m[/bold]")
    console.print(table, Text("b\u202e", "red"))
    written = stream.getvalue()
    assert "\x1b[31m" in written
    assert "\x1b[8m" not in written
    assert all(text in written for text in ("[red]title :x:", "[bold]a\\u001b[8m[/bold]", "b\\u202e"))


def test_print_beside_a_display_is_shown_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, PlainStream(stream))
    before = sys.stdout, sys.stderr
    console = PlainConsole(stderr=True, force_terminal=True, width=80)
    with show_display(Live("the display", console=console, auto_refresh=False)):
        print("one\x1b[8m two\x1b]8;;file:///etc\x07", file=sys.stderr)
        with set_aside():
            print("question\x9b", file=sys.stderr)
        print("three\x1b[8m")
    assert (sys.stdout, sys.stderr) == before
    written = stream.getvalue()
    assert "the display" in written
    assert "one\\u001b[8m two\\u001b]8;;file:///etc\\u0007" in written
    assert "question\\u009b" in written
    assert "three\\u001b[8m" in written
    assert "\x1b[8m" not in written
