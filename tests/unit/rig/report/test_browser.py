"""Pages in a real browser: desktop and phone, light and dark, nothing fetched, nothing cut or overlapping."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.report.compare import compare_lifts
from rig.report.compare_page import compare_page
from rig.report.sides import session_side
from rig.report.write import write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium here: install chromium to run this test"
)

SEEN = """(() => {
  const out = {figures: 0, cut: [], overlap: [], small: [], wide: document.documentElement.scrollWidth};
  for (const svg of document.querySelectorAll('svg')) {
    const frame = svg.getBoundingClientRect();
    if (frame.width > 100 && frame.height > 60) out.figures++;
    const texts = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim());
    const boxes = texts.map(t => t.getBoundingClientRect());
    texts.forEach((t, i) => {
      const b = boxes[i], name = svg.getAttribute('aria-label') + ': ' + t.textContent;
      const scale = frame.width / svg.viewBox.baseVal.width;
      if (parseFloat(getComputedStyle(t).fontSize) * scale < 8) out.small.push(name);
      if (b.left < frame.left - 1 || b.right > frame.right + 1 || b.top < frame.top - 1 ||
          b.bottom > frame.bottom + 1) out.cut.push(name);
      for (let j = i + 1; j < boxes.length; j++) {
        const o = boxes[j];
        const x = Math.min(b.right, o.right) - Math.max(b.left, o.left);
        const y = Math.min(b.bottom, o.bottom) - Math.max(b.top, o.top);
        if (x > 1.5 && y > 3) out.overlap.push(name + ' / ' + texts[j].textContent);
      }
    });
  }
  out.pictures = [...document.images].every(i => i.complete && i.naturalWidth > 0);
  out.paper = getComputedStyle(document.body).backgroundColor;
  return JSON.stringify(out);
})()"""


class Browser:
    """Chromium without a window, driven over its debugging pipe: JSON messages, ended by a zero byte."""

    def __init__(self, profile: Path) -> None:
        to_it, self._write = os.pipe()
        self._read, from_it = os.pipe()
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        command = [str(CHROMIUM), *flags, f"--user-data-dir={profile}", "about:blank"]
        # it reads commands from 3 and writes answers to 4
        start = (
            f"import os; os.dup2({to_it}, 3); os.dup2({from_it}, 4); os.execv({command[0]!r}, {command!r})"
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", start],
            pass_fds=(to_it, from_it),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_it)
        os.close(from_it)
        self._rest, self._number, self._session = b"", 0, None
        self.events: list[dict[str, Any]] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, page: Path, width: int, scheme: str) -> dict[str, Any]:
        """Open a page and return what is seen of it."""
        self.events.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.call("Page.navigate", url=page.as_uri())
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self._next()
        return json.loads(self.call("Runtime.evaluate", expression=SEEN)["result"]["value"])

    def said(self) -> list[str]:
        """Errors and lines on the console."""
        loud = {"Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown"}
        return [str(event["params"]) for event in self.events if event["method"] in loud]

    def fetched(self) -> list[str]:
        """Addresses asked for, but the page's own and what lies inside it."""
        asked = (
            e["params"]["request"]["url"] for e in self.events if e["method"] == "Network.requestWillBeSent"
        )
        return [url for url in asked if not url.startswith(("data:", "file:"))]

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(10)
        os.close(self._write)
        os.close(self._read)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            more = os.read(self._read, 1 << 16)
            assert more, "chromium ended"
            self._rest += more
        line, self._rest = self._rest.split(b"\0", 1)
        message = json.loads(line)
        if "method" in message:
            self.events.append(message)
        return message


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
    broken = drawn_trial(folder / "broken", (12.0,))
    (broken / "session.json").write_text("{}")
    return {
        "trial": write_report([trial]).path,
        "recording": write_report([drawn_recording(folder / "recording")]).path,
        "table": write_report([tables], folder / "table.html").path,
        "comparison": comparison,
        "broken": write_report([broken]).path,
    }


FIGURES = {"trial": 9, "recording": 3, "table": 5, "comparison": 1, "broken": 0}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("kind", FIGURES)
def test_a_page_opens_quietly_with_every_label_readable(
    browser: Browser, pages: dict[str, Path], kind: str, width: int, scheme: str
) -> None:
    seen = browser.open(pages[kind], width, scheme)
    assert browser.said() == []
    assert browser.fetched() == []
    assert seen["figures"] == FIGURES[kind]
    assert seen["pictures"]
    assert seen["cut"] == []
    assert seen["overlap"] == []
    assert seen["small"] == []
    assert seen["wide"] <= width
    bright = sum(int(part) for part in seen["paper"].removeprefix("rgb(").removesuffix(")").split(","))
    assert (bright > 600) == (scheme == "light")
