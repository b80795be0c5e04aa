"""A headless browser for tests of pages; without an installed browser they are skipped."""

import base64
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NEEDS_CHROMIUM = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium here: install chromium to run this test"
)

SEEN = """(() => {
  const out = {figures: 0, cut: [], overlap: [], small: [], wide: document.documentElement.scrollWidth};
  for (const svg of document.querySelectorAll('svg')) {
    const frame = svg.getBoundingClientRect();
    if (frame.width > 50 && frame.height > 30) out.figures++;
    const texts = [...svg.querySelectorAll('text')].filter(
      t => t.textContent.trim() && t.getBoundingClientRect().width > 0);  // thumbnails hide theirs
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
  out.figures += document.querySelectorAll('.plotted').length;
  const parts = text => text.match(/[\\d.]+/g).map(Number);
  const bright = rgb => {
    const linear = c => c <= .04045 ? c / 12.92 : ((c + .055) / 1.055) ** 2.4;
    const [r, g, b] = rgb.slice(0, 3).map(c => linear(c / 255));
    return .2126 * r + .7152 * g + .0722 * b;
  };
  const ground = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = parts(getComputedStyle(at).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  out.faint = [...document.body.querySelectorAll('*')].filter(element => {
    const own = [...element.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
    if (!own || !element.getClientRects().length || element.closest('script, style, option')) return false;
    const style = getComputedStyle(element);
    const text = parts(element instanceof SVGElement ? style.fill : style.color);
    const [low, high] = [bright(text), bright(ground(element))].sort((a, b) => a - b);
    return (high + .05) / (low + .05) < 4.5;
  }).map(element => element.textContent.slice(0, 40));
  out.pictures = [...document.images].every(i => i.complete && i.naturalWidth > 0);
  out.paper = getComputedStyle(document.body).backgroundColor;
  return JSON.stringify(out);
})()"""
"""Program that returns the measurements of a page. faint: texts with a contrast below 4.5."""
FLAWS = ("cut", "overlap", "small", "faint")


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

    def open(self, address: str, width: int, scheme: str = "light", height: int = 900) -> None:
        """Open a page in a window of this size, px, and wait until it is loaded."""
        self.events.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.call("Page.navigate", url=address)
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self._next()

    def seen(self, address: str, width: int, scheme: str) -> dict[str, Any]:
        """Open a page; return its measurements, see `SEEN`."""
        self.open(address, width, scheme)
        return json.loads(self.value(SEEN))

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page; wait for it if it is a promise."""
        found = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def click(self, x: float, y: float) -> None:
        """Press and release the left button at a place of the window, px."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def key(self, name: str, text: str = "", shift: bool = False) -> None:
        """Press and release a key, such as ArrowLeft, or n with its text."""
        common = {"key": name, "modifiers": 8 if shift else 0}
        self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **common)
        self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    def picture(self) -> bytes:
        """Return what the window shows, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

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
