"""`rig live` on two MJPEG streams of 60 frames per second, seen in a browser.

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
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from statistics import median

import pytest

from support.browser import FLAWS, NEEDS_CHROMIUM, SEEN, Browser
from support.desk_streams import desk_streams
from support.waiting import LIMIT_S, until

MEASURED_S = 5.0


@contextmanager
def live(folder: Path, *arguments: str) -> Iterator[tuple[str, int]]:
    """Run `rig live`; yield its page's address and its process id."""
    command = [sys.executable, "-P", "-m", "rig", "live", *arguments, "--no-browser"]
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
@pytest.mark.long
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
            until(
                lambda: browser.value("document.querySelector('#sensors .curve path.band') !== null"), LIMIT_S
            )
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
                    lambda: browser.value("document.querySelector('#sensors .curve path.estimate') !== null"),
                    LIMIT_S,
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
