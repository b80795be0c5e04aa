"""Walk `docs/my_sensor.md` with the simulated sensor and make its pictures: `python docs/draw_my_sensor.py`.

Needs Chromium and a clone. The clip, its labels and the scores stay in the folder given with --out.
"""

import argparse
import math
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from drivers.clock import SystemClock, to_ns  # noqa: E402 - found through the paths above
from fakes.devices.desk import OFF_S, Demonstration, DeskDigit  # noqa: E402 - the same
from support.browser import Browser  # noqa: E402 - the same

PICTURES, SIZE_PX, QUALITY = ROOT / "docs" / "pictures", (960, 500), 70
LINE_PX, PIVOT_PX, CLICK_SIGMA_PX = ((31.0, 153.0), (177.0, 124.0)), (144.7, 126.5), 0.7
"""Two marks of the simulated object at angle 0, the point about which it turns, and the error of a click."""
STATE = "[...document.querySelectorAll('.tile b')].some(tile => /^({})$/.test(tile.textContent))"
RECORD = "document.querySelector('[data-do=record]').click()"


def start(folder: Path, *words: str) -> tuple[subprocess.Popen[str], str]:
    """Start a command of the rig; return its process and the address of its page."""
    command = [sys.executable, "-u", "-m", "rig", *words, "--no-browser"]
    pipe = subprocess.PIPE
    process = subprocess.Popen(  # noqa: S603 - the rig's own command
        command, cwd=folder, stdout=pipe, stderr=subprocess.STDOUT, text=True
    )
    for line in process.stdout or ():
        if "http://" in line:
            return process, next(word for word in line.split() if "http" in word).rstrip(";")
    raise SystemExit(f"rig {' '.join(words)} shows no page")


def keep(browser: Browser, name: str) -> None:
    """Store what the browser shows as a picture of the page."""
    png = np.frombuffer(browser.picture(), np.uint8)
    image = cv2.imdecode(png, cv2.IMREAD_COLOR)
    cv2.imwrite(str(PICTURES / f"my_sensor_{name}.webp"), image, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])


def wait(browser: Browser, states: str, then_s: float) -> None:
    """Wait until the page shows one of the states, and for a time after it."""
    while not browser.value(STATE.format(states)):
        time.sleep(0.05)
    time.sleep(then_s)


def record(browser: Browser, folder: Path) -> Path:
    """Record one press of the simulated object on the live page; return the clip."""
    process, address = start(folder, "live", "fake")
    browser.open(address, SIZE_PX[0], height=SIZE_PX[1])
    wait(browser, "no contact", 0.2)
    keep(browser, "background")
    browser.value(RECORD)
    wait(browser, "tracking|rekeyed", 1.5)
    keep(browser, "press")
    time.sleep(4.0)
    keep(browser, "turn")
    wait(browser, "no contact", 0.5)
    browser.value(RECORD)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    process.wait(30)
    return next((folder / "clips").iterdir())


def turns_deg(clip: Path) -> list[float]:
    """Return the true rotation of the object in each frame.

    The object is taken off within one frame, which gives the time of the clip in the cycle of the simulation.
    """
    rows = (clip / "timestamps.csv").read_text(encoding="utf-8").split()[1:]
    times_s = np.array([float(row.split(",")[1]) for row in rows])
    images = [cv2.imread(str(path)).astype(float) for path in sorted((clip / "frames").iterdir())]
    steps = [float(np.abs(after - before).mean()) for before, after in pairwise(images)]
    offset_s = OFF_S - float(times_s[int(np.argmax(steps)) + 1])
    sensor = DeskDigit("SIM-DESK1", 1, Demonstration(0), SystemClock())
    return [sensor.turn_deg(to_ns(float(time_s + offset_s))) or 0.0 for time_s in times_s]


def label(browser: Browser, folder: Path, clip: Path) -> None:
    """Draw the same two marks on each frame, in both passes, as a person does with a click error."""
    turns, rng = turns_deg(clip), np.random.default_rng(0)
    process, address = start(folder, "label-angle", str(clip))
    browser.open(address, SIZE_PX[0] + 240, height=SIZE_PX[1] + 120)
    time.sleep(1.0)
    for number in range(20):
        frame = int(browser.value("frame()"))
        cos, sin = math.cos(math.radians(turns[frame])), math.sin(math.radians(turns[frame]))
        if number == 4:  # the frame before shows its line
            browser.value("go(place - 1)")
            time.sleep(0.5)
            keep(browser, "label")
            browser.value("go(place + 1)")
        for end in LINE_PX:
            x, y = np.subtract(end, PIVOT_PX)
            at = np.add(PIVOT_PX, (cos * x + sin * y, cos * y - sin * x)) + rng.normal(0, CLICK_SIGMA_PX, 2)
            browser.value(f"click({at[0]}, {at[1]})")
            browser.value("(async () => { await queue; })()")
    browser.value("at('write').click()")
    process.wait(30)


def main() -> None:
    """Walk the page, and print the scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Folder to work in; it must not exist.")
    folder = parser.parse_args().out.absolute()
    folder.mkdir(parents=True)
    browser = Browser(folder / "browser")
    clip = record(browser, folder)
    label(browser, folder, clip)
    rig = [sys.executable, "-m", "rig"]
    score = ["benchmark", "clips", str(clip), "--estimator", "slip", "--out", "my_unit"]
    subprocess.run([*rig, *score], cwd=folder, check=True)  # noqa: S603 - the same
    browser.open((folder / "my_unit" / "index.html").as_uri(), SIZE_PX[0], height=SIZE_PX[1])
    browser.value("document.querySelector('.beside').previousElementSibling.scrollIntoView()")
    keep(browser, "error")
    browser.close()
    sheet = PICTURES / "my_sensor_protractor.svg"
    subprocess.run([*rig, "calibrate", "board", "protractor", "--out", str(sheet)], check=True)  # noqa: S603 - the same


if __name__ == "__main__":
    main()
