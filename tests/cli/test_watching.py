"""`--watch`: a page in a browser shows a run and does not change its results."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.live.feed import Inbox, Listener
from rig.live.state import Progress, WatchState
from rig.terminal.onlookers import Event
from support.benches import short_phases
from support.command_line import refusal, rig, succeed
from support.marks import heavy

AtTerminal = Callable[[list[str], int], Any]
TIPS = {"SIM-D0001", "SIM-D0002"}


class Page:
    """Takes the place of the page: keeps the events, and the state that browsers would get."""

    def __init__(self, folder: Path) -> None:
        self.inbox = Inbox(str(folder / "page"))
        self.listener, self.address = Listener(self.inbox.address, pictures=True), "http://page/"
        self.events: list[Event] = []
        self.begun: list[Progress] = []
        self.values: dict[str, Any] = {}

    def __call__(self, at: tuple[str, int], *shown: Any) -> "Page":
        self.begun.append(Progress(*shown))
        self.state = WatchState(self.begun[0], self.inbox.take)
        return self

    def show_event(self, event: Event) -> None:
        self.events.append(event)
        self.state.progress = self.state.progress.after(event)
        self.values = self.state.values()

    def show_report(self, file: Path) -> None:
        pytest.fail(f"no report was asked for: {file}")

    def close(self) -> None:
        self.values = self.state.values()


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """The page of the next command."""
    made = Page(tmp_path)
    monkeypatch.setattr("rig.live.watch.WatchPage", made)
    yield made
    made.inbox.close()


@pytest.mark.heavy
def test_watching_does_not_change_the_results(
    page: Page, one_lift: Path, light_bench_file: Path, tmp_path: Path
) -> None:
    with short_phases():
        done = rig(
            "trial", "--lifts", 1, "--object", "toothbrush", "--bench", light_bench_file, "--jobs", 1,
            "--no-report", "--out", tmp_path / "s", "--json", "--watch",
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "watch page: http://page/" in done.stderr
    assert (tmp_path / "s" / "lifts.jsonl").read_bytes() == (one_lift / "lifts.jsonl").read_bytes()
    assert [event for event in page.events if event.kind != "progress"] == [Event("end", "done")]
    assert any(isinstance(lift["estimate_deg"], float) for lift in page.values["lifts"])
    assert page.values["pictures"].keys() > TIPS
    (begun,) = page.begun
    assert begun.title.startswith("SIMULATED trial on bench")
    assert (begun.what, begun.done, begun.total, page.values["done"]) == ("lifts", 0, 1, 1)


@pytest.mark.heavy
def test_recording_can_be_watched(page: Page, light_bench_file: Path, tmp_path: Path) -> None:
    succeed(
        "record", "--object", 7, "--poses", 1, "--images", 4, "--bench", light_bench_file, "--no-report",
        "--out", tmp_path / "s", "--watch-at", "127.0.0.1:0",
    )  # fmt: skip
    assert page.values["pictures"].keys() >= TIPS
    assert page.begun[0].what == "poses"


@pytest.mark.heavy
def test_calibration_can_be_watched(page: Page, light_bench_file: Path, tmp_path: Path) -> None:
    blocks = ("--block-mm", 20, "--block-mm", 45, "--block-mm", 70)
    succeed(
        "calibrate", "gripper", *blocks, "--bench", light_bench_file, "--out", tmp_path, "--json",
        "--watch",
    )  # fmt: skip
    assert [event for event in page.events if event.kind != "progress"] == [Event("end", "done")]
    assert page.values["pictures"].keys() == {*TIPS, "SIM-C0001"}
    assert page.begun == [Progress("SIMULATED calibrate gripper on bench 'fake'", "contacts", 0, 0)]
    assert (page.values["done"], page.values["total"]) == (6, 6)
    assert "counts closing" in " ".join(page.values["finished"])


@pytest.mark.heavy
@pytest.mark.parametrize("what", [("tactile",), *heavy((("markers",),), (("tcp", "--poses", 4),))])
def test_every_calibration_reports_its_progress(
    what: tuple[object, ...], light_bench_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[Event] = []
    monkeypatch.setattr("rig.terminal.onlookers._observers", [events.append])
    succeed("calibrate", *what, "--bench", light_bench_file, "--out", tmp_path)
    progress = [event for event in events if event.kind == "progress"]
    assert progress[-1].done == progress[-1].total == len(progress)


def test_watch_options_are_rejected_with_recorded_samples(tmp_path: Path) -> None:
    for options in (("--watch",), ("--watch-at", "127.0.0.1:0")):
        for what in ("camera", "hand-eye", "markers", "tactile", "gripper", "tcp", "sync"):
            done = refusal("calibrate", what, "--from", tmp_path, *options)
            assert f"{options[0]} is for a calibration on a bench" in done, what


def test_invalid_watch_options_are_rejected_before_the_session(tmp_path: Path) -> None:
    options = ("--lifts", 1, "--object", "toothbrush", "--watch-at", "nowhere")
    assert "write host and port" in refusal("trial", *options, "--out", tmp_path / "s")
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


@pytest.mark.heavy
def test_page_modules_are_not_imported_without_watch() -> None:
    code = "import sys, rig.cli.main, rig.experiments.trial; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    loaded = set(done.stdout.split())
    assert "rig.live.observer" in loaded
    assert not loaded & {"rig.live.watch", "rig.pages.serving"}
