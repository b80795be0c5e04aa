"""`--watch`: a page in a browser shows a run and does not change its results."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest

from rig.live.watch import WatchPage
from rig.terminal.onlookers import Event, observed_by
from support.command_line import rig
from support.marks import long
from support.waiting import until

AtTerminal = Callable[[list[str], int], Any]


TIPS = {"SIM-D0001", "SIM-D0002"}


class Browser:
    """Requests a page repeatedly from the time when its address is printed."""

    def __init__(self) -> None:
        self.states: list[dict[str, Any]] = []
        self.events: list[Event] = []
        self.pictures: set[str] = set()
        self.stuck: list[socket.socket] = []
        self._thread: threading.Thread | None = None

    def hear(self, text: str) -> None:
        print(text, file=sys.stderr)
        if text.startswith("watch page: "):
            address = text.removeprefix("watch page: ")
            at = urlsplit(address)
            self.stuck = [socket.create_connection((at.hostname, at.port)) for _ in range(2)]
            self.stuck[0].sendall(b"GET / HTTP/1.0\r\n\r\n")
            self._thread = threading.Thread(target=self._look, args=(address,))
            self._thread.start()
            until(lambda: bool(self.states), 60.0)  # the run begins when its page is served

    def close(self) -> None:
        assert self._thread is not None
        self._thread.join(60)
        for each in self.stuck:
            each.close()

    def _look(self, address: str) -> None:
        try:
            while True:
                with urlopen(address + "state.json", timeout=120) as answer:
                    self.states.append(json.load(answer))
                for serial in self.states[-1]["pictures"]:
                    with urlopen(f"{address}picture/{serial}.jpg", timeout=120) as answer:
                        assert answer.read(2) == b"\xff\xd8"
                        self.pictures.add(serial)
                time.sleep(0.05)  # as a page does, so that the command gets the computer
        except OSError:  # it has ended
            pass


@pytest.fixture
def browser(monkeypatch: pytest.MonkeyPatch) -> Browser:
    """A browser of the page of the next command; the page stays until both fingertips have been shown."""
    made, close = Browser(), WatchPage.close

    def close_when_seen(page: WatchPage) -> None:
        ends = time.monotonic() + 120.0
        while not made.pictures >= TIPS and time.monotonic() < ends:
            time.sleep(0.02)
        close(page)

    @contextmanager
    def observed_too(observer: Callable[[Event], None]) -> Iterator[None]:
        with observed_by(made.events.append), observed_by(observer):
            yield

    monkeypatch.setattr("rig.cli.resuming.say", made.hear)
    monkeypatch.setattr("rig.cli.resuming.observed_by", observed_too)
    monkeypatch.setattr(WatchPage, "close", close_when_seen)
    return made


def test_watching_does_not_change_the_results(
    browser: Browser, one_lift: Path, light_bench_file: Path, tmp_path: Path
) -> None:
    done = rig(
        "trial", "--lifts", 1, "--object", "toothbrush", "--bench", light_bench_file, "--jobs", 1,
        "--no-report", "--out", tmp_path / "s", "--json", "--watch",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    browser.close()
    assert (tmp_path / "s" / "lifts.jsonl").read_bytes() == (one_lift / "lifts.jsonl").read_bytes()
    assert [event for event in browser.events if event.kind != "progress"] == [Event("end", "done")]
    lifts = [lift for state in browser.states for lift in state["lifts"]]
    assert any(isinstance(lift["estimate_deg"], float) for lift in lifts)
    assert browser.pictures > TIPS
    assert browser.states[0]["title"].startswith("SIMULATED trial on bench")
    assert (browser.states[0]["done"], browser.states[0]["total"]) == (0, 1)


def test_recording_can_be_watched(browser: Browser, light_bench_file: Path, tmp_path: Path) -> None:
    done = rig(
        "record", "--object", 7, "--poses", 1, "--images", 4, "--bench", light_bench_file, "--no-report",
        "--out", tmp_path / "s", "--watch-at", "127.0.0.1:0",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    browser.close()
    assert browser.pictures >= TIPS
    assert browser.states[0]["what"] == "poses"


@pytest.mark.long
def test_calibration_can_be_watched(browser: Browser, light_bench_file: Path, tmp_path: Path) -> None:
    blocks = ("--block-mm", 20, "--block-mm", 45, "--block-mm", 70)
    done = rig(
        "calibrate", "gripper", *blocks, "--bench", light_bench_file, "--out", tmp_path, "--json",
        "--watch",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    browser.close()
    assert [event for event in browser.events if event.kind != "progress"] == [Event("end", "done")]
    assert browser.pictures == {"SIM-D0001", "SIM-D0002", "SIM-C0001"}
    titles = {(state["title"], state["what"], state["total"]) for state in browser.states}
    assert titles == {("SIMULATED calibrate gripper on bench 'fake'", "contacts", 6)}
    assert browser.states[-1]["done"] > 0
    assert any("counts closing" in state["newest"] for state in browser.states)


@pytest.mark.parametrize(
    "what",
    [("tactile",), *long((("markers",),), (("tcp", "--poses", 4),))],
)
def test_every_calibration_reports_its_progress(
    what: tuple[object, ...], light_bench_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[Event] = []
    monkeypatch.setattr("rig.terminal.onlookers._observers", [events.append])
    done = rig("calibrate", *what, "--bench", light_bench_file, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    progress = [event for event in events if event.kind == "progress"]
    assert progress[-1].done == progress[-1].total == len(progress)


def test_watch_options_are_rejected_with_recorded_samples(tmp_path: Path) -> None:
    for options in (("--watch",), ("--watch-at", "127.0.0.1:0")):
        for what in ("camera", "hand-eye", "markers", "tactile", "gripper", "tcp", "sync"):
            done = rig("calibrate", what, "--from", tmp_path, *options)
            assert done.returncode == 2
            assert f"{options[0]} is for a calibration on a bench" in done.stderr, what


def test_invalid_watch_options_are_rejected_before_the_session(tmp_path: Path) -> None:
    options = ("--lifts", 1, "--object", "toothbrush", "--watch-at", "nowhere")
    done = rig("trial", *options, "--out", tmp_path / "s")
    assert done.returncode == 2
    assert "write host and port" in done.stderr
    assert not (tmp_path / "s").exists()


def test_waiting_question_is_reported_to_observers(at_terminal: AtTerminal) -> None:
    code = """if True:
        from rig.terminal.questions import ask
        from rig.terminal.onlookers import observed_by
        def observe(event):
            print("event", event.kind, event.text, flush=True)
        with observed_by(observe):
            ask("Place it. Ready?")
    """
    terminal = at_terminal([sys.executable, "-c", code], 80)
    terminal.wait_for("Place it. Ready? [y/N]:")
    assert "event question Place it. Ready?" in terminal.text()
    assert "event answered" not in terminal.text()
    terminal.type("y\n")
    terminal.wait_for("event answered")
    terminal.wait_for("event end done")


def test_page_modules_are_not_imported_without_watch() -> None:
    code = "import sys, rig.cli.main, rig.experiments.trial, rig.live.session; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    loaded = set(done.stdout.split())
    assert "rig.live.observer" in loaded
    assert not loaded & {"rig.live.watch", "rig.pages.serving"}
