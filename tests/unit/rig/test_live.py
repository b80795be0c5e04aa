"""Messages of the live view never block, and lifts are shown on the terminal."""

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.clock import to_ns
from fakes.clock import SimulatedClock
from rig.live.feed import KEPT_MESSAGES, LARGEST_BYTES, Inbox, Listener, Message, Sender
from rig.live.trial_view import TrialView
from rig.results.notes import lift_note
from rig.sessions.records import Lift
from rig.terminal.screen import TimeLeft, left_text
from support.waiting import until

LIFT = {"number": 3, "object": "t1", "name": "wrench", "lift": 2, "sender": 7}
FIGURES = {
    "time_ns": 5, "phase": "B", "estimate": [(4, -3.0, 0.2), (5, -3.14, 0.2)], "truth": [(5, -3.06)],
    "rates_hz": {"D1": 60.0, "D2": 59.5, "camera": None}, "dropped": {"D1": 0, "D2": 2, "camera": 1},
}  # fmt: skip


def wait_for(inbox: Inbox, count: int) -> list[Message]:
    messages: list[Message] = []
    until(lambda: len(messages.extend(inbox.take()) or messages) >= count)
    return messages


def test_messages_arrive_and_images_only_on_request(tmp_path: Path) -> None:
    table, viewer = Inbox(str(tmp_path / "t")), Inbox(str(tmp_path / "v"))
    sender = Sender([Listener(table.address, False), Listener(viewer.address, True)])
    picture = os.urandom(30_000) + b"\n"
    sender.send("frame", {"serial": "D1"}, picture)
    sender.send("phase", {"phase": "B"})
    assert wait_for(viewer, 2) == [
        Message("frame", {"serial": "D1"}, picture),
        Message("phase", {"phase": "B"}),
    ]
    assert wait_for(table, 1) == [Message("phase", {"phase": "B"})]
    assert sender.lost == 0
    for end in (sender, table, viewer):
        end.close()


def test_messages_without_a_reader_are_dropped_without_blocking(tmp_path: Path) -> None:
    absent = Sender([Listener(str(tmp_path / "nobody"), True)])
    absent.send("phase", {})
    absent.send("frame", {}, b"x" * LARGEST_BYTES)
    assert absent.lost == 2
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stopped:
        stopped.bind(str(tmp_path / "stopped"))
        sender = Sender([Listener(str(tmp_path / "stopped"), True)])
        for _ in range(100):  # a socket that waited would never come back from this
            sender.send("frame", {}, b"x" * 20_000)
        assert 0 < sender.lost < 100
    sender.close()
    absent.close()


def test_late_reader_gets_the_newest_messages(tmp_path: Path) -> None:
    inbox = Inbox(str(tmp_path / "a"))
    sender = Sender([Listener(inbox.address, False)])
    count = KEPT_MESSAGES + 200
    for number in range(count):
        lost = sender.lost
        sender.send("phase", {"n": number})
        while sender.lost > lost:  # the inbox's own thread is behind: this test is not about that
            lost = sender.lost
            time.sleep(0.001)
            sender.send("phase", {"n": number})
    sender.close()
    inbox.close()  # what was sent before is received first
    numbers = [message.values["n"] for message in inbox.take()]
    assert len(numbers) == KEPT_MESSAGES
    assert numbers[-1] == count - 1
    assert not Path(inbox.address).exists()


def test_invalid_messages_are_ignored(tmp_path: Path) -> None:
    inbox = Inbox(str(tmp_path / "a"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        for data in (b"hello", b"[1, 2]\n", b'{"no": "kind"}\n', Message("phase", {"n": 1}).pack()):
            stranger.sendto(data, inbox.address)
    assert wait_for(inbox, 1) == [Message("phase", {"n": 1})]
    inbox.close()


def test_time_left_excludes_start_up_and_pieces_of_the_earlier_run() -> None:
    clock = SimulatedClock()
    left = TimeLeft(10, clock=clock)
    clock.sleep_until(to_ns(60.0))  # libraries load, workers start
    left.piece_done(6, 10)
    assert left.counting_down() is None
    clock.sleep_until(to_ns(70.0))
    left.piece_done(7, 10)
    assert left.counting_down() == pytest.approx(30.0)
    clock.sleep_until(to_ns(75.0))
    assert left.counting_down() == pytest.approx(25.0)
    assert left_text(11.8) == "about 12 s left"
    assert left_text(79.6) == "about 1 min 20 s left"
    assert left_text(7200) == "about 2.0 h left"


def test_time_left_follows_the_pace_of_the_present_part_or_of_the_earlier_run() -> None:
    clock = SimulatedClock()
    left = TimeLeft(0, clock=clock)
    for done, total, time_s in ((1, 2, 0.0), (2, 2, 600.0), (1, 64, 620.0), (2, 64, 630.0)):
        clock.sleep_until(to_ns(time_s))
        left.piece_done(done, total)
    assert left.counting_down() == pytest.approx(620.0)  # 62 pieces of 10 s
    left = TimeLeft(45, done=25, clock=clock, usual_s=6.0)
    assert left.seconds() == pytest.approx(120.0)
    left.begin()
    clock.sleep_until(to_ns(642.0))  # the first two lifts include the start of two worker processes
    assert 100.0 < (left.seconds((0.15, 0.15)) or 0.0) < 180.0  # without the earlier pace 788 s


def test_progress_is_printed_as_lines_without_a_terminal(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    lift_row: Callable[..., Lift],
) -> None:
    monkeypatch.setattr("rig.live.trial_view.PLAIN_EVERY_S", 0.02)
    inbox = Inbox(str(tmp_path / "a"))
    sender = Sender([Listener(inbox.address, False)])
    row = lift_row(3, lift=2, final_truth_deg=-8.0)
    text = ""
    with TrialView(5, inbox, lift_note) as view:
        sender.send("figures", {**LIFT, **FIGURES})
        deadline = time.monotonic() + 120.0
        while "phase B" not in text and time.monotonic() < deadline:
            time.sleep(0.02)
            text += capsys.readouterr().err
        view(1, 5, row)
        assert not view.lines()
    text += capsys.readouterr().err
    assert (
        "t1 wrench lift 2, phase B: estimate -3.1 deg, markers -3.1 deg; "
        "frames/s D1 60, D2 60, camera -; dropped 3" in text
    )
    assert "1/5 t1 wrench lift 2: slipped, turned -8.0 deg, mean error 0.50 deg" in text
    assert "\x1b" not in text
    sender.close()
    inbox.close()
