"""`rig live` in a browser: on two MJPEG streams of 60 frames per second, the fake, and given readings.

With `-s` it prints the figures: delay from a frame's capture to the screen, dropped frames, share of a core;
time from the command to the page and to a live angle.
"""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from itertools import product
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from drivers.images import encode_jpeg
from rig.live.feed import OBJECT, Sender
from rig.live.state import KEPT_PICTURE_BYTES, PICTURES_PER_S
from rig.live.watch import WatchPage, watch_address
from support.browser import FLAWS, NEEDS_CHROMIUM, SEEN, Browser
from support.desk_frames import write_desk_clip
from support.desk_streams import desk_streams
from support.waiting import LIMIT_S, until

MEASURED_S = 5.0


@contextmanager
def live(folder: Path, *arguments: str, name: str = "live") -> Iterator[tuple[str, int]]:
    """Run `rig live`, or another command with a page; yield its page's address and its process id."""
    command = [sys.executable, "-P", "-m", "rig", name, *arguments, "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=folder) as process:
        lines = iter(process.stderr.readline, "")
        try:
            address = next(found[0] for line in lines if (found := re.search(r"http://\S+/(?=;)", line)))
            yield address, process.pid
        finally:
            process.terminate()
            said = process.stderr.read()
        assert process.wait(LIMIT_S) == 0, said


def cpu_s(pid: int) -> float:
    """Processor time of a process and its children so far."""
    total = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            if pid in (int(stat.parent.name), int(fields[1])):
                total += int(fields[11]) + int(fields[12])
    return total / os.sysconf("SC_CLK_TCK")


@NEEDS_CHROMIUM
@pytest.mark.heavy
def test_two_streams_are_shown_with_their_delay_and_dropped_frames(tmp_path: Path) -> None:
    browser = Browser(tmp_path / "profile")
    try:
        with desk_streams() as urls, live(tmp_path, *urls, "--sensor", "digit") as (address, pid):
            browser.open(address, 1280)
            until(lambda: browser.value("Object.keys(live.cards).length") == 3, LIMIT_S)
            time.sleep(2.0)
            began, before = time.monotonic(), (cpu_s(pid), browser.value(STATE))
            delays = []
            for _ in range(int(MEASURED_S)):
                time.sleep(1.0)
                delays += browser.value("live.delays")
            after = cpu_s(pid), browser.value(STATE)
            spent_s = time.monotonic() - began
            dropped = {n: after[1]["dropped"][n] - before[1]["dropped"][n] for n in after[1]["dropped"]}
            rate_hz = (after[1]["records"] - before[1]["records"]) / spent_s
            print(
                f"\ncapture to screen: median {median(delays):.0f} ms, highest {max(delays):.0f} ms; page "
                f"{rate_hz:.0f} updates per second; dropped {dropped}; "
                f"rig live {100 * (after[0] - before[0]) / spent_s:.0f} % of a core"
            )
            assert len(dropped) == 3
            assert min(dropped.values()) >= 0
            assert min(delays) > 0
            assert rate_hz > 0
            assert browser.said() == []
    finally:
        browser.close()


STATE = (
    "({records: live.records, dropped: Object.fromEntries(Object.entries(live.cards)"
    ".map(([name, one]) => [name, +/(\\d+) dropped/.exec(one.more.textContent)[1]]))})"
)


@NEEDS_CHROMIUM
@pytest.mark.heavy
def test_page_shows_the_angle_and_its_buttons_act(tmp_path: Path) -> None:
    browser = Browser(tmp_path / "profile")
    try:
        started_s = time.monotonic()
        with live(tmp_path, "fake") as (address, _):
            browser.open(address, 1280)
            opened_s = time.monotonic() - started_s

            def shown(what: str) -> bool:
                return what in browser.value("document.body.innerText")

            until(lambda: shown("SIMULATED rig live fake") and shown("no contact"), LIMIT_S)
            browser.value("document.querySelector('[data-do=reference]').click()")
            until(lambda: shown("press an object on the gel") or shown("reference taken"), LIMIT_S)
            until(lambda: shown("tracking"), LIMIT_S)
            until(lambda: shown("\u00b1"), LIMIT_S)
            angle_s = time.monotonic() - started_s
            print(f"\nfrom the command to the page {opened_s:.1f} s, to a live angle {angle_s:.1f} s")
            assert browser.value("document.querySelector('#sensors canvas').height") == 320
            until(lambda: browser.value("document.querySelector('#chart path.band') !== null"), LIMIT_S)
            browser.value("document.querySelector('[data-do=record]').click()")
            until(lambda: shown("recording to clips") and shown("Stop recording"), LIMIT_S)
            browser.value("document.querySelector('[data-do=record]').click()")
            until(lambda: shown("recorded clips"), LIMIT_S)
            browser.value(
                "(chosen => { chosen.value = 'ellipse'; chosen.dispatchEvent(new Event('change')); })"
                "(document.getElementById('estimator'))"
            )
            until(lambda: shown("estimator ellipse"), LIMIT_S)
            assert browser.said() == []
            assert browser.fetched() == [url for url in browser.fetched() if url.startswith(address)]
            for width, scheme in product((1400, 390), ("light", "dark")):
                browser.open(address, width, scheme)
                until(
                    lambda: browser.value("document.querySelector('#chart path.estimate') !== null"), LIMIT_S
                )
                seen = json.loads(browser.value(SEEN))
                assert {name: seen[name] for name in FLAWS if seen[name]} == {}
                assert seen["wide"] <= width
                assert browser.said() == []
        (clip,) = (tmp_path / "clips").iterdir()
        assert {path.name for path in clip.iterdir()} == {
            "frames", "background.png", "timestamps.csv", "clip.json",
        }  # fmt: skip
    finally:
        browser.close()


EVERY_S = 0.1
CHART = """JSON.stringify({
  bands: [...document.querySelectorAll('#chart .band')].map(e => e.getBoundingClientRect()),
  runs: document.querySelector('#chart .estimate').getAttribute('d').match(/M/g).length,
  references: [...document.querySelectorAll('#chart .reference')].map(e => e.getBoundingClientRect().x),
  lost: (document.querySelector('#chart .dropped')?.getAttribute('d').match(/M/g) || []).length,
  text: document.body.innerText})"""
DOUBT = "this background looks like a contact: lift the object, press Take background"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with closing(Browser(tmp_path_factory.mktemp("browser") / "profile")) as opened:
        yield opened


class Shown:
    """A page of `rig live` and the sensor whose readings it shows."""

    def __init__(self, browser: Browser) -> None:
        self.page = WatchPage(watch_address(None), "SIMULATED rig live fake", estimators=["slip"])
        self._sender = Sender([self.page.listener])
        self.browser, self.time_s = browser, 100.0

    def send(
        self, count: int, state: str, angle_deg: float | None, picture: bytes = b"", **more: object
    ) -> None:
        for _ in range(count):
            self.time_s += EVERY_S
            reading = {
                "sender": 1, "sensor": "D1", "t_s": self.time_s, "state": state, "angle_deg": angle_deg,
                "sigma_deg": None if angle_deg is None else 1.0, "rate_deg_s": None, "slip": False,
                "fps": 10.0, "latency_ms": 1.0, "dropped": 0, "zero_s": None, "background": "taken",
                "doubt": "", "recording": False, "outline": [], "slips_s": [], **more,
            }  # fmt: skip
            until(lambda reading=reading: self._sent("sensor", reading, picture), LIMIT_S)

    def notice(self, text: str) -> None:
        until(lambda: self._sent("notice", {"sender": 1, "text": text}), LIMIT_S)

    def mark(self, time_s: float, text: str) -> None:
        until(lambda: self._sent("mark", {"t_s": time_s, "text": text}), LIMIT_S)

    def _sent(self, kind: str, values: dict[str, object], picture: bytes = b"") -> bool:
        lost = self._sender.lost
        self._sender.send(kind, values, picture)
        return self._sender.lost == lost

    def status(self) -> str:
        return self.browser.value("document.getElementById('said').textContent")

    def chart(self) -> dict:
        until(lambda: self.browser.value("document.querySelector('#chart .estimate') !== null"), LIMIT_S)
        until(lambda: self.browser.value("live.drawnTo") >= self.time_s - 1e-6, LIMIT_S)
        return json.loads(self.browser.value(CHART))

    def close(self) -> None:
        self._sender.close()
        self.page.close()


@pytest.fixture
def shown(browser: Browser) -> Iterator[Shown]:
    with closing(Shown(browser)) as one:
        browser.open(one.page.address, 1280)
        yield one


def two_presses(shown: Shown) -> list[float]:
    """Send two contacts with a gap between; return the times of their references and of the release."""
    shown.send(10, "no_contact", None)
    first_s = shown.time_s + EVERY_S
    shown.send(20, "tracking", 5.0, zero_s=first_s)
    released_s = shown.time_s
    shown.send(30, "no_contact", None, zero_s=first_s)
    shown.send(5, "tracking", 8.0, zero_s=None)
    second_s = shown.time_s + EVERY_S
    shown.send(20, "tracking", 1.0, zero_s=second_s)
    return [first_s, second_s, released_s]


@NEEDS_CHROMIUM
def test_curve_and_band_are_interrupted_without_contact_and_at_a_reference(shown: Shown) -> None:
    two_presses(shown)
    chart = shown.chart()
    assert chart["runs"] == len(chart["bands"]) == 3
    first, second, third = sorted(chart["bands"], key=lambda box: box["left"])
    assert second["left"] - first["right"] > 5 * (third["left"] - second["right"]) > 0
    assert len(chart["references"]) == 2
    assert abs(chart["references"][0] - first["left"]) < 3
    assert abs(chart["references"][1] - third["left"]) < 3
    assert "Dotted line: reference" in chart["text"]


IN_VIEW = """JSON.stringify({
  hidden: [...document.querySelectorAll('#sensors .tile:first-child, #sensors canvas, #chart')].filter(e => {
    const box = e.getBoundingClientRect();
    return e.getClientRects().length && (box.top < 0 || box.bottom > innerHeight || box.right > innerWidth);
  }).map(e => e.parentElement.outerHTML.slice(0, 90)),
  covered: [...document.querySelectorAll('#chart, #events')].filter(e => {
    const one = e.getBoundingClientRect(), bar = document.getElementById('moment').getBoundingClientRect();
    return Math.min(one.bottom, bar.bottom) - Math.max(one.top, bar.top) > 0;
  }).map(e => e.id),
  rows: [...document.querySelectorAll('#events button')].map(e => Math.round(e.getBoundingClientRect().top)),
  names: [...document.querySelectorAll('#chart path')].map(e => e.getAttribute('class')).filter(Boolean)})"""


@NEEDS_CHROMIUM
@pytest.mark.heavy
@pytest.mark.parametrize("names", [["D1"], ["D1", "D2"]], ids=["one", "two"])
@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080), (390, 844)])
def test_angle_picture_and_chart_are_in_view_at_once(
    shown: Shown, names: list[str], size: tuple[int, int]
) -> None:
    tall = encode_jpeg(np.full((320, 240, 3), 99, np.uint8), 90)
    for state, angle_deg in (("no_contact", None), ("tracking", -0.01)):
        for name in names:
            shown.send(1, state, angle_deg, picture=tall, sensor=name)
        if len(names) > 1:
            shown.send(4, state, angle_deg, sensor=OBJECT)
    browser = shown.browser
    browser.open(shown.page.address, size[0], height=size[1])
    shown.chart()
    until(lambda: browser.value("document.querySelector('canvas').height") == 320, LIMIT_S)
    seen = json.loads(browser.value(IN_VIEW))
    assert (seen["hidden"], seen["covered"]) == ([], [])
    assert seen["rows"] == sorted(set(seen["rows"])), "one line per event"
    assert [name for name in seen["names"] if name in ("first", "second", "estimate")][-1] == "estimate"
    assert "+0.0\u00b0" in browser.value("document.body.innerText")


@NEEDS_CHROMIUM
def test_range_of_the_chart_contains_a_useful_band_and_a_wide_one_flattens_no_curve(shown: Shown) -> None:
    shown.send(5, "tracking", 90.0, sigma_deg=70.0)
    shown.send(20, "tracking", 60.0, sigma_deg=4.0, zero_s=1.0)
    shown.chart()
    limits = "[...document.querySelectorAll('#chart text')].map(e => e.textContent)"
    assert "+90.0\u00b0" in shown.browser.value(limits)
    shown.send(20, "tracking", 88.0, sigma_deg=4.0, zero_s=1.0)
    shown.chart()
    assert "+92.0\u00b0" in shown.browser.value(limits)


@NEEDS_CHROMIUM
def test_dropped_frames_are_marked_and_counted(shown: Shown) -> None:
    shown.send(10, "tracking", 5.0, dropped=2)
    shown.send(1, "tracking", 5.0, dropped=5)
    shown.send(10, "tracking", 5.0, dropped=5)
    shown.send(10, "tracking", 5.0, dropped=6)
    chart = shown.chart()
    assert chart["lost"] == 2
    assert "6 dropped (4 in the chart, red marks: the computer or the sensor was too slow)" in chart["text"]


@NEEDS_CHROMIUM
@pytest.mark.heavy
def test_status_follows_the_state_and_a_notice_lasts_some_seconds(shown: Shown) -> None:
    def sent(state: str, angle_deg: float | None, zero_s: float | None = 100.5) -> str:
        shown.send(1, state, angle_deg, zero_s=zero_s)
        return shown.status()

    taken = "D1: background taken"
    shown.notice(taken)
    until(lambda: sent("no_contact", None) == taken, LIMIT_S)
    wait = "Contact: hold the object still until the reference is taken."
    until(lambda: sent("tracking", 0.1, None) == wait, LIMIT_S)
    for state, angle_deg, text in (
        ("rekeyed", 0.1, "The angle counts from the reference: turn the object."),
        ("unobservable", None, "The contact is round or smooth: its angle cannot be seen."),
        ("no_contact", None, "No contact: press an object on the gel."),
    ):
        until(lambda of=(state, angle_deg), text=text: sent(*of) == text, LIMIT_S)
    shown.notice("recording to clips/x")
    until(lambda: sent("tracking", 0.1) == "recording to clips/x", LIMIT_S)
    until(lambda: sent("tracking", 0.1).startswith("The angle counts"), LIMIT_S)
    shown.browser.open(shown.page.address, 1280)
    until(lambda: shown.status().startswith("The angle counts"), LIMIT_S)
    shown.send(3, "tracking", 0.1, doubt=DOUBT)
    until(lambda: f"D1: {DOUBT}" in shown.browser.value("document.body.innerText"), LIMIT_S)
    shown.send(3, "no_contact", None)
    until(lambda: DOUBT not in shown.browser.value("document.body.innerText"), LIMIT_S)


def pressed_keys(shown: Shown, *keys: str) -> float | None:
    """Press keys on the slider; return the moment that the page shows then, None for the newest frame."""
    shown.browser.value("document.getElementById('slider').focus()")
    for key in keys:
        shown.browser.key(key.removeprefix("Shift+"), shift=key.startswith("Shift+"))
    return shown.browser.value("live.at")


@NEEDS_CHROMIUM
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_history_is_scrubbed_events_lead_to_their_moment_and_live_goes_on(
    shown: Shown, width: int, scheme: str
) -> None:
    black, white = (encode_jpeg(np.full((40, 30, 3), value, np.uint8), 90) for value in (0, 255))
    shown.send(100, "no_contact", None, picture=black)
    contact_s = shown.time_s + EVERY_S
    shown.send(1, "tracking", 5.0, picture=white, zero_s=contact_s, rate_deg_s=2.0)
    shown.send(200, "tracking", 7.0, picture=white, zero_s=contact_s)
    browser = shown.browser
    browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
    browser.open(shown.page.address, width, scheme)
    shown.chart()

    def seen(what: str) -> bool:
        return what in browser.value("document.body.innerText")

    def light(value: int) -> None:
        pixel = "document.querySelector('canvas').getContext('2d').getImageData(9, 9, 1, 1).data[0]"
        until(lambda: browser.value(pixel) == value, LIMIT_S)

    assert seen("Live: the newest frame")
    assert not browser.value("document.body.classList.contains('past')")
    browser.value(
        "[...document.querySelectorAll('#events button')].find(b => b.innerText.endsWith('contact')).click()"
    )
    assert seen("The page shows 20.0 s ago; press Live to go on")
    assert browser.value("document.body.classList.contains('past')")
    assert seen("+5.0\u00b0")
    assert seen("2.0\u00b0/s")
    light(255)
    shown.send(10, "tracking", 9.0, picture=white, zero_s=contact_s, dropped=3, doubt=DOUBT)
    until(lambda: seen("The page shows 21.0 s ago"), LIMIT_S)
    assert seen("+5.0\u00b0"), "new frames do not replace the past one"
    assert pressed_keys(shown, "Shift+ArrowLeft") == pytest.approx(contact_s - EVERY_S, abs=1e-5)
    assert seen("no contact")
    light(0)
    assert pressed_keys(shown, "ArrowRight", "ArrowRight") == pytest.approx(contact_s + 0.3, abs=1e-5)
    browser.key("m", "m")
    until(lambda: shown.page.take_action() == f"mark {contact_s + 0.3:.6f}", LIMIT_S)
    shown.mark(contact_s + 0.3, "mark 1")
    until(lambda: browser.value("document.querySelector('#chart .mark') !== null"), LIMIT_S)
    assert seen("mark 1")
    assert pressed_keys(shown, "Home") == pytest.approx(100.0 + EVERY_S, abs=1e-5)
    assert pressed_keys(shown, "PageUp") == pytest.approx(110.0 + EVERY_S, abs=1e-5)
    measured = json.loads(browser.value(SEEN))
    assert {name: measured[name] for name in FLAWS if measured[name]} == {}
    assert measured["wide"] <= width
    browser.value("document.getElementById('live').click()")
    assert seen("Live: the newest frame")
    assert seen("+9.0\u00b0")
    light(255)
    assert pressed_keys(shown, "ArrowLeft", "End") is None
    browser.value("document.querySelector('.word').focus()")
    assert browser.value("document.getElementById('meaning').innerText").startswith(
        "Standard deviation of the angle"
    )
    browser.key("Escape")
    assert browser.value("document.getElementById('meaning').hidden")
    assert [line for line in browser.said() if "getImageData" not in line] == [], "but for our reading pixels"


@NEEDS_CHROMIUM
def test_moment_whose_image_is_not_kept_any_more_shows_none(shown: Shown) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    large = encode_jpeg(noise, 90)
    for _ in range(KEPT_PICTURE_BYTES // len(large) + 20):
        shown.time_s += 1.0 / PICTURES_PER_S
        shown.send(1, "tracking", 5.0, picture=large, zero_s=1.0)
    shown.chart()
    opaque = "document.querySelector('canvas').getContext('2d').getImageData(9, 9, 1, 1).data[3]"
    until(lambda: shown.browser.value(opaque) == 255, LIMIT_S)
    pressed_keys(shown, "Home")
    until(lambda: shown.browser.value(opaque) == 0, LIMIT_S)
    pressed_keys(shown, "End")
    until(lambda: shown.browser.value(opaque) == 255, LIMIT_S)


@NEEDS_CHROMIUM
@pytest.mark.heavy
def test_stored_clip_is_shown_as_a_whole(tmp_path: Path, browser: Browser) -> None:
    clip = tmp_path / "clip"
    write_desk_clip(clip, 6.8)
    with live(tmp_path, str(clip), "--estimator", "ellipse", name="show") as (address, _):
        for width, scheme in ((390, "dark"), (1400, "light")):
            browser.open(address, width, scheme)
            until(lambda: browser.value("document.querySelector('#chart .estimate') !== null"), LIMIT_S)
            measured = json.loads(browser.value(SEEN))
            assert {name: measured[name] for name in FLAWS if measured[name]} == {}
            assert measured["wide"] <= width
        assert "0.00 s of 4.77 s" in browser.value("document.body.innerText")
        assert "SIMULATED clip" in browser.value("document.title").replace(str(tmp_path) + "/", "")
        browser.value("[...document.querySelectorAll('#events button')].at(-1).click()")
        assert browser.value("live.at") > 0.9
        moment = browser.value("live.at")
        browser.value("document.getElementById('slider').focus()")
        browser.key(" ", " ")
        until(lambda: browser.value("live.at") > moment + 0.5, LIMIT_S)
        browser.key(" ", " ")
        stopped = browser.value("live.at")
        assert browser.value("document.getElementById('play').innerText") == "Play"
        browser.value("document.getElementById('play').click()")
        assert browser.value("document.getElementById('play').innerText") == "Pause"
        until(lambda: browser.value("live.at") == 4.766667, LIMIT_S)
        assert stopped < browser.value("live.at")
        assert browser.value("document.getElementById('play').innerText") == "Play"
        until(lambda: browser.value("document.querySelector('canvas').height") == 320, LIMIT_S)
        assert "tracking" in browser.value("document.querySelector('.tiles').innerText")
        assert browser.said() == []
