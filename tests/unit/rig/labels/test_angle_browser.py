"""Lines drawn in a real browser, by mouse and by keys alone."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.images import read_image
from rig.benchmark.clips.labelled import read_clips
from rig.frames.series import read_frames
from rig.labels.angle_lines import LINES, LineLog, choose_frames, load_clip
from rig.labels.angle_server import AngleServer
from support.angle_clips import FIRST_CONTACT, ask, true_ends, write_clip
from support.browser import NEEDS_CHROMIUM, Browser

pytestmark = NEEDS_CHROMIUM
FRAMES = [2, 8, 13]
IDLE = (
    "(async () => { await queue; await picture.decode().catch(() => 0); return at('said').textContent; })()"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    opened = Browser(tmp_path_factory.mktemp("chromium"))
    yield opened
    opened.close()


@pytest.fixture
def clip(tmp_path: Path, press: Callable[..., NDArray[np.uint8]], blank: NDArray[np.uint8]) -> Path:
    return write_clip(tmp_path / "clip", press, blank)


@pytest.fixture
def server(clip: Path) -> Iterator[AngleServer]:
    series, background = read_frames(clip / "frames"), read_image(clip / "background.png")
    to_label = load_clip("clip", series, background, choose_frames(series, background, 3, FIRST_CONTACT)[0])
    with AngleServer(to_label, LineLog(clip / LINES, to_label)) as running:
        yield running


def opened(browser: Browser, server: AngleServer, width: int = 1280) -> None:
    """Open the page, and wait until it knows the clip."""
    browser.open("about:blank", width)
    browser.open(server.address, width)
    browser.value(IDLE)


def state_of(server: AngleServer) -> dict[str, Any]:
    return ask(server.address, "clip")[1]["state"]


def click_at(browser: Browser, x: float, y: float) -> str:
    """Click a position in the frame, px; return the page's text once the click is stored."""
    browser.value("at('drawing').scrollIntoView({block: 'center'})")
    box = "(b => [b.left, b.top, b.width / known.width])(canvas.getBoundingClientRect())"
    left, top, zoom = browser.value(box)
    browser.click(left + (x + 0.5) * zoom, top + (y + 0.5) * zoom)
    return browser.value(IDLE)


@pytest.mark.parametrize("width", [1280, 390])
def test_two_passes_by_mouse_become_labels(
    browser: Browser, server: AngleServer, clip: Path, width: int
) -> None:
    opened(browser, server, width)
    said = ""
    for _ in (0, 1):
        for frame in FRAMES:
            assert f"frame {frame}" in browser.value("at('where').textContent")
            for x, y in true_ends(frame):
                said = click_at(browser, x, y)
    assert "Both passes are done" in said
    assert browser.value("at('count').textContent").startswith("6 of 6 lines")
    assert browser.value("document.documentElement.scrollWidth") <= width
    browser.value("at('write').click()")
    assert "You may close this page" in browser.value(IDLE)
    assert server.labels_written(timeout_s=5.0) == 3
    (found,) = read_clips(clip)
    assert [label.angle_deg for label in found.labels] == pytest.approx([15.0, 40.0], abs=0.6)
    assert browser.said() == []


def test_everything_can_be_done_by_keys(browser: Browser, server: AngleServer) -> None:
    opened(browser, server)
    browser.key("ArrowRight", shift=True)
    browser.key("Enter", "\r")
    for _ in range(5):
        browser.key("ArrowUp", shift=True)
    browser.key("Enter", "\r")
    browser.value(IDLE)
    assert state_of(server)["ends"][0] == {"2": [[130.0, 160.0], [130.0, 110.0]]}
    assert "frame 8" in browser.value("at('where').textContent"), "a finished line leads to the next frame"
    browser.key("d", "d")
    assert "difference/8.png" in browser.value("picture.getAttribute('src')")
    browser.key("n", "n")
    browser.key("o", "o")
    assert "Pass 2 of 2, frame 13" in browser.value("at('where').textContent")
    browser.key("u", "u")
    browser.value(IDLE)
    assert state_of(server)["ends"][0] == {"2": [[130.0, 160.0]]}
    assert "Pass 1 of 2, frame 2 " in browser.value("at('where').textContent"), "undo shows what it took back"


def test_reloaded_page_shows_drawn_lines_and_continues(browser: Browser, server: AngleServer) -> None:
    opened(browser, server)
    for x, y in true_ends(2):
        click_at(browser, x, y)
    opened(browser, server)
    assert "frame 8" in browser.value("at('where').textContent")
    assert browser.value("at('count').textContent").startswith("1 of 6 lines")


def test_ended_command_is_reported_on_the_page(browser: Browser, server: AngleServer) -> None:
    opened(browser, server)
    browser.value("window.fetch = () => Promise.reject(new TypeError('gone'))")
    assert "the command has ended" in click_at(browser, *true_ends(2)[0])
    assert browser.value("ends().length") == 0, "discarded ends are not shown"
