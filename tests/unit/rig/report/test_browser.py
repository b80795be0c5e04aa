"""Pages in a real browser: desktop and phone, light and dark, nothing fetched, nothing cut or overlapping."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.verdict import limits
from drivers.types import Pose
from rig.benchmark.harness import Cell, machine, table_of
from rig.calibrate import charts
from rig.calibrate.result import CalibrationResult, Figure, file_result
from rig.pages.page import render
from rig.report.compare import compare_lifts, compare_page
from rig.report.parts import Table
from rig.report.sessions_page import write_sessions
from rig.report.sides import session_side
from rig.report.write import write_report
from rig.results.listing import list_session
from support.browser import FLAWS, NEEDS_CHROMIUM, Browser
from support.waiting import until

pytestmark = NEEDS_CHROMIUM


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    opened = Browser(tmp_path_factory.mktemp("chromium"))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def pages(
    drawn_trial: Any, drawn_recording: Any, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """A page of each kind."""
    folder = tmp_path_factory.mktemp("pages")
    trial = drawn_trial(folder / "trial")
    other = drawn_trial(folder / "other", errors_deg=(1.0, 1.5))
    tables = folder / "tables"
    tables.mkdir()
    table = tables / "a lift with a name that goes on and on.csv"
    (tables / ("no_lift_" * 12 + ".csv")).write_text("what,else\n1,2\n")
    rows = [f"{i / 50},{min(max(i - 40, 0), 60) / 5 + 0.3},{min(max(i - 40, 0), 60) / 5}" for i in range(180)]
    table.write_text("t_s,estimate_deg,truth_deg\n" + "\n".join(rows) + "\n")
    sides = session_side(trial), session_side(other)
    comparison = folder / "compare.html"
    found = compare_lifts(("trial", "2026-11-21T093000_obj07_trial"), sides[0].lifts, sides[1].lifts)
    comparison.write_text(compare_page(found, simulated=True, about="Two sessions."))
    listing = folder / "sessions.html"
    write_sessions(listing, folder, list(map(list_session, (trial, other))), {"session": ["trial", "other"]})
    broken = drawn_trial(folder / "broken", (12.0,))
    (broken / "session.json").write_text("{}")
    return {
        "trial": write_report([trial]).path,
        "recording": write_report([drawn_recording(folder / "recording")]).path,
        "table": write_report([tables], folder / "table.html").path,
        "comparison": comparison,
        "sessions": listing,
        "broken": write_report([broken]).path,
        "calibration": calibration(folder),
        "clips": clips_page(folder / "clips.html"),
    }


def clips_page(path: Path) -> Path:
    """The page of `rig benchmark clips`, with its widest table."""
    shares, times = ["100% [61, 100]"] * 5, ["0 of 4", "11.9, 14.7, 110.8", "0.14"]
    cells = ["a_gelsight_mini", "all", "42", *shares, *["5.20"] * 4, *times]
    row = [Cell(str(n), cell, f"median up to {n} deg") for n, cell in enumerate(cells)]
    shown = {"tables": [table_of("Errors", [row] * 5, left=2)], "clips": [], "simulated": "SIMULATED"}
    values = {"folder": "clips", "of": machine(), "verdict": "", "time_and_error": "", **shown}
    path.write_text(render("rig.benchmark.clips", "clips.html", **values))
    return path


def calibration(folder: Path) -> Path:
    """A calibration's page with a chart of each kind."""
    places = np.random.default_rng(0).uniform(20, 460, (40, 2))
    samples = {f"sample {i:03d}": 0.001 * (i + 1) for i in range(40)}
    curve = np.linspace(0.0, 1.0, 50), np.linspace(-0.004, 0.004, 50)
    text, grey = "What it shows.", np.full((480, 640), 90, np.uint8)
    streams, points = {"arm": curve, "camera SIM-C0001, moved": curve}, {"points": tuple(places.T)}
    placed = {"TCP": POSES, "camera": [Pose((0.9, 0.1, 0.4))], "base": [Pose((0.0, 0.0, 0.0))]}
    pictures = [
        charts.bars("Bars", text, samples, "px", limit=0.03),
        charts.field("Field", text, np.ones((6, 8)), (640, 480), "sigma, px", places),
        charts.residuals("Residuals", text, places, places / 1e4, (640, 480)),
        charts.residuals("Residuals on a picture", text, places, places / 1e4, (640, 480), grey),
        charts.curves("Curves", text, streams, "s", "value"),
        charts.curves("Points", text, points, "x, px", "up, px", "."),
        charts.poses(text, placed),
    ]
    figures = [
        Figure("add_to_stream_s", 0.0012, "to add to the stream", ".1f", "ms", 1e3, top=True),
        Figure("", "2 " * 30, "a long name of a number with a long value"),
    ]
    checked = limits(
        (0.4, 1.0, 5.0, "the offset is known to {value:.2f} ms only: wiggle faster"),
        (8, 10, 5, "{value} samples used; 15 are good"),
    )
    result = CalibrationResult(
        "sync", {"stream": "SIM-C0001"}, {}, checked, figures, source="folder", used=40, pictures=pictures,
        simulated=True,
    )  # fmt: skip
    return Path(file_result(result, folder)["page"])


TILTS = [Rotation.from_euler("xy", (180, 4 * i), degrees=True) for i in range(12)]
POSES = [Pose.from_rotation((0.4 + 0.02 * i, 0.05 * i - 0.3, 0.2), tilt) for i, tilt in enumerate(TILTS)]
FIGURES = {
    "trial": 12, "recording": 3, "table": 5, "comparison": 3, "sessions": 1, "broken": 0, "calibration": 6,
    "clips": 0,
}  # fmt: skip
"""Figures that are seen; poses in 3D are not counted."""


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
@pytest.mark.parametrize("kind", FIGURES)
def test_page_opens_without_messages_and_with_readable_labels(
    browser: Browser, pages: dict[str, Path], kind: str, width: int, scheme: str
) -> None:
    seen = browser.seen(pages[kind].as_uri(), width, scheme)
    assert browser.said() == []
    assert browser.fetched() == []
    assert seen["figures"] == FIGURES[kind]
    assert seen["pictures"]
    assert {name: seen[name] for name in FLAWS if seen[name]} == {}
    assert seen["wide"] <= width
    cut = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth).length"
    assert width < 1400 or browser.value(cut) == 0, "a table is cut"
    bright = sum(int(part) for part in seen["paper"].removeprefix("rgb(").removesuffix(")").split(","))
    assert (bright > 600) == (scheme == "light")


def lift_shown(browser: Browser) -> str:
    return browser.value("document.querySelector('#explorer h3').textContent")


def box_of(browser: Browser, element: str) -> dict[str, float]:
    """Return the rectangle of an element on the screen, px. element: in JavaScript."""
    return json.loads(browser.value(f"JSON.stringify({element}.getBoundingClientRect())"))


def wait(browser: Browser, ms: int = 200) -> None:
    browser.value(f"new Promise(done => setTimeout(done, {ms}))")


@pytest.mark.heavy
def test_page_without_films_has_no_slider_and_no_word_of_frames(
    browser: Browser, pages: dict[str, Path]
) -> None:
    text = "document.getElementById('explorer').innerText"
    for kind, filmed in (("trial", True), ("comparison", False), ("table", False)):
        browser.open(pages[kind].as_uri(), 1400)
        assert ("frames of that time" in " ".join(browser.value(text).split())) == filmed
        assert (box_of(browser, "document.querySelector('#explorer input')")["width"] > 0) == filmed


def test_hover_links_plots_slider_and_film(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(f"{pages['trial'].as_uri()}#lift-2", 1400)
    assert lift_shown(browser) == "wrench, lift 2"
    wait(browser)
    over = box_of(browser, "document.querySelector('#explorer .u-over')")
    moved = {"x": over["left"] + 0.9 * over["width"], "y": over["top"] + 0.5 * over["height"]}
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", **moved)
    values = browser.value(
        "[...document.querySelectorAll('.u-series')].map(row => row.textContent).join('; ')"
    )
    assert re.search(r"estimate - markers:?-?\d\.\d\d", values), values
    slider = browser.value("document.querySelector('#explorer input').valueAsNumber")
    ends = "['min', 'max'].map(end => Number(document.querySelector('#explorer input')[end]))"
    first, last = browser.value(ends)
    assert slider == pytest.approx(first + 0.9 * (last - first), abs=0.1)
    at_end = browser.value("document.querySelector('.screen').style.backgroundPositionY")
    assert float(at_end.removesuffix("%")) > 60.0
    browser.value("document.querySelector('[data-step=\"1\"]').click()")
    wait(browser)
    assert lift_shown(browser) == "wrench, lift 1"
    assert browser.said() == []


def test_table_of_lifts_sorts_and_filters_with_its_thumbnails(
    browser: Browser, pages: dict[str, Path]
) -> None:
    names = "[...document.querySelectorAll('table.explored tbody tr')].map(row => row.cells[0].textContent)"
    browser.open(pages["trial"].as_uri(), 1400)
    assert browser.value(names) == ["wrench, lift 1", "wrench, lift 2"]
    for wanted in (["wrench, lift 2", "wrench, lift 1"], ["wrench, lift 1", "wrench, lift 2"]):
        browser.value("document.querySelectorAll('table.explored th button')[7].click()")  # true turn
        assert browser.value(names) == wanted
    browser.value(
        "(() => { const search = document.querySelector('.filter input[type=search]');"
        "search.value = 'lift 2'; search.form.dispatchEvent(new Event('input')); })()"
    )
    assert browser.value("document.querySelector('.filter output').textContent") == "1 of 2"
    assert browser.value("document.querySelectorAll('.thumbs figure[hidden]').length") == 1


def test_figures_over_all_lifts_show_values_zoom_and_open_lifts(
    browser: Browser, pages: dict[str, Path]
) -> None:
    browser.open(pages["trial"].as_uri(), 1400)
    plot = "[...document.querySelectorAll('.plotted')][1]"
    browser.value(f"{plot}.scrollIntoView({{block: 'center'}})")
    wait(browser)
    over = box_of(browser, f"{plot}.querySelector('.u-over')")
    near = f"{plot}.querySelector('.near')"
    ink = f"{plot}.querySelector('canvas').toDataURL()"

    def mouse(kind: str, x: float, y: float, **how: Any) -> None:
        at = {"x": over["left"] + x * over["width"], "y": over["top"] + y * over["height"]}
        browser.call("Input.dispatchMouseEvent", type=kind, **at, **how)

    def dragged(x: float, y: float, to_x: float, to_y: float) -> None:
        mouse("mouseMoved", x, y)
        mouse("mousePressed", x, y, button="left", clickCount=1)
        mouse("mouseMoved", (x + to_x) / 2, (y + to_y) / 2, button="left")
        mouse("mouseMoved", to_x, to_y, button="left")
        mouse("mouseReleased", to_x, to_y, button="left", clickCount=1)
        wait(browser)

    whole = browser.value(ink)
    dragged(0.3, 0.3, 0.8, 0.8)
    assert browser.value(ink) != whole
    browser.value(f"{plot}.querySelector('.u-over').dispatchEvent(new MouseEvent('dblclick'))")
    wait(browser)
    assert browser.value(ink) == whole
    assert browser.value(f"{near}.hidden")
    found = "", 0.0, 0.0
    for step in range(1, 20):  # along the diagonal, on which the lifts are
        mouse("mouseMoved", step / 20, 1 - step / 20)
        wait(browser, 30)
        if not browser.value(f"{near}.hidden"):
            found = browser.value(f"{near}.textContent"), step / 20, 1 - step / 20
            break
    assert re.fullmatch(r"wrench, lift \d: estimate .*°, markers .*°", found[0])
    mouse("mousePressed", *found[1:], button="left", clickCount=1)
    mouse("mouseReleased", *found[1:], button="left", clickCount=1)
    until(lambda: lift_shown(browser) == found[0].partition(":")[0], 10.0)
    assert browser.said() == []


def test_page_without_javascript_shows_every_figure_at_full_width(
    browser: Browser, pages: dict[str, Path]
) -> None:
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        seen = browser.seen(pages["trial"].as_uri(), 1400, "light")
        narrowest = "Math.min(...[...document.querySelectorAll('.thumbs svg')].map(svg => svg.clientWidth))"
        assert browser.value(narrowest) > 300
        assert browser.value("document.querySelector('#explorer').hidden")
        poses = browser.seen(pages["calibration"].as_uri(), 390, "light")
        name = browser.value("document.querySelector('.poses svg').getAttribute('aria-label')")
        assert name == "poses in 3D: TCP, camera, base"
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert (seen["figures"], seen["cut"], seen["overlap"]) == (FIGURES["trial"], [], [])
    assert (poses["figures"], poses["cut"], poses["overlap"]) == (7, [], [])


def test_names_in_a_table_of_lifts_stay_text(browser: Browser, tmp_path: Path) -> None:
    table = tmp_path / "<img src=x onerror=alert(1)><script>alert(2)<!--.csv"
    table.write_text("t_s,estimate_deg,truth_deg\n0,0,0\n1,2,2\n2,3,3\n")
    page = write_report([table], tmp_path / "page.html").path
    browser.open(page.as_uri(), 1400)
    assert lift_shown(browser).startswith("<img src=x onerror=alert(1)>")
    assert browser.value("document.querySelectorAll('img, body > script:not([type])').length") == 2
    assert browser.said() == []


def test_two_ticked_sessions_show_the_command_that_compares_them(
    browser: Browser, pages: dict[str, Path]
) -> None:
    browser.open(pages["sessions"].as_uri(), 1400)
    shown = "!document.getElementById('compared').hidden"
    ticks = "document.querySelectorAll('td input[type=checkbox]')"
    assert browser.value(f"{ticks}.length") == 2
    browser.value(f"{ticks}[0].click()")
    assert not browser.value(shown)
    browser.value(f"{ticks}[1].click()")
    assert browser.value(shown)
    command = browser.value("document.querySelector('#compared code').textContent")
    folder = pages["sessions"].parent
    assert command == f"rig compare {folder / 'trial'} {folder / 'other'}"
    browser.value(f"{ticks}[0].click()")
    assert not browser.value(shown)
    assert browser.said() == []


def test_a_page_of_a_thousand_sessions_opens_within_five_seconds(browser: Browser, tmp_path: Path) -> None:
    cells = [["t1 wrench", "0.50 ± 0.20", "12.0", "complete"] for _ in range(1000)]
    links = [[f"session_{i:04d}", *row] for i, row in enumerate(cells)]
    table = Table(("session", "objects", "MARE", "MB", "state"), links, text=(0, 1, 4), filters={4: "choose"})
    page = tmp_path / "sessions.html"
    values = {"simulated": True, "folder": "a folder", "table": table, "charts": [], "made": "now"}
    page.write_text(render("rig.report", "sessions.html", **values))
    browser.open(page.as_uri(), 1400)
    timing = "performance.getEntriesByType('navigation')[0].loadEventEnd"
    assert browser.value(timing) < 5000.0
    assert browser.value("document.querySelector('.filter output').textContent") == "1000 of 1000"
    assert browser.said() == []


def test_poses_rotate_by_mouse_and_keys_and_name_the_pose_under_the_pointer(
    browser: Browser, pages: dict[str, Path]
) -> None:
    browser.open(pages["calibration"].as_uri(), 1280)
    canvas = "document.querySelector('.poses canvas')"
    browser.value(f"{canvas}.scrollIntoView({{block: 'center'}})")
    drawn = f"new Promise(done => requestAnimationFrame(() => done({canvas}.toDataURL())))"
    box = box_of(browser, canvas)
    middle = {"x": box["left"] + box["width"] / 2, "y": box["top"] + box["height"] / 2}
    views = [browser.value(drawn)]
    browser.call("Input.dispatchMouseEvent", type="mousePressed", button="left", clickCount=1, **middle)
    for across in (20, 60):
        moved = {"x": middle["x"] + across, "y": middle["y"]}
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", button="left", **moved)
    browser.call("Input.dispatchMouseEvent", type="mouseReleased", button="left", clickCount=1, **moved)
    views.append(browser.value(drawn))
    browser.value(f"{canvas}.focus()")
    browser.key("ArrowUp")
    views.append(browser.value(drawn))
    assert len(set(views)) == 3
    # The pose under the pointer is drawn in another colour: the pointer leaves all poses first.
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=box["left"] + 2, y=box["top"] + 2)
    browser.value(f"{canvas}.dispatchEvent(new MouseEvent('dblclick'))")
    until(lambda: browser.value(drawn) == views[0], 30.0)
    text = "document.querySelector('.poses .small').textContent"
    assert browser.value(text).startswith("Grid: 0.2 m.")
    everywhere = "[...Array(80).keys()].flatMap(i => [...Array(60).keys()].map(j => [i / 80, j / 60]))"
    names = browser.value(
        f"(() => {{ const canvas = {canvas}, box = canvas.getBoundingClientRect();"
        f"return [...new Set({everywhere}.map(([x, y]) => {{"
        "canvas.dispatchEvent(new PointerEvent('pointermove', {"
        "clientX: box.left + x * box.width, clientY: box.top + y * box.height}));"
        f"return {text}; }}))]; }})()"
    )
    assert "camera: x 0.900, y 0.100, z 0.400 m" in names
    assert browser.said() == []


def test_long_pages_have_contents_whose_links_lead_there(browser: Browser, pages: dict[str, Path]) -> None:
    links = (
        "[...document.querySelectorAll('nav a')].map(a => [a.textContent, "
        "document.querySelector(a.getAttribute('href')).textContent])"
    )
    browser.open(pages["trial"].as_uri(), 1280, "light")
    found = json.loads(browser.value(f"JSON.stringify({links})"))
    assert len(found) >= 4
    assert all(text == heading for text, heading in found)


def test_calibration_page_lists_the_limits_of_its_verdict(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(pages["calibration"].as_uri(), 1280)
    rows = (
        "[...document.querySelector('table').rows].map(row => [...row.cells].map(cell => cell.textContent))"
    )
    assert browser.value(rows) == [
        ["measured", "result", "good", "usable"],
        ["the offset is known to 0.40 ms", "good", "at most 1", "at most 5"],
        ["8 samples used", "weak", "at least 10", "at least 5"],
    ]
