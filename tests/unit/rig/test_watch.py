"""The page of `--watch`: it shows the newest values, changes nothing, and delays nothing."""

import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPMessage
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from drivers.errors import InputError, OperatorStopError
from drivers.images import encode_jpeg
from rig.live.feed import KEPT_MESSAGES, Inbox, Listener, Message, Sender
from rig.live.state import KEPT_FAULTS, KEPT_POINTS, RECORD_HEAD, Progress, StateNews, WatchState
from rig.live.watch import READ_EVERY_S, WatchPage, watch_address
from rig.pages.serving import BURST, MOST_PER_S
from rig.terminal.onlookers import Event, announce, announce_question, announcing, observed_by
from support import waiting
from support.browser import NEEDS_CHROMIUM, Browser
from support.waiting import until

LIFT = {"number": 3, "object": "t1", "name": "wrench", "lift": 2, "sender": 7}
FIGURES = {
    "time_ns": 5, "phase": "B", "estimate": [(4, -3.0, 0.2), (5, -3.14, 0.2)], "truth": [(5, -3.06)],
    "rates_hz": {"D1": 60.0}, "dropped": {"D1": 2},
}  # fmt: skip
JPEG = b"\xff\xd8 a picture"


@contextmanager
def served() -> Iterator[WatchPage]:
    made = WatchPage(watch_address(None), "SIMULATED trial <b>", "lifts", 1, 5)
    yield made
    made.close()


@pytest.fixture
def page() -> Iterator[WatchPage]:
    with served() as made:
        yield made


@pytest.fixture(scope="module")
def still_page() -> Iterator[WatchPage]:
    """A page that is asked and shown nothing new."""
    with served() as made:
        yield made


def request(
    page: WatchPage, path: str, method: str = "GET", body: bytes | None = None, **headers: str | None
) -> tuple[int, bytes, HTTPMessage]:
    """Send a request; return status, body and headers of the answer. headers: Host, Cookie ..."""
    connection = HTTPConnection("127.0.0.1", page.process.port, timeout=waiting.LIMIT_S)
    sent = {name.replace("_", "-"): value for name, value in headers.items() if value is not None}
    connection.request(method, path, body, sent)
    answer = connection.getresponse()
    found = answer.status, answer.read(), answer.headers
    connection.close()
    return found


def get(page: WatchPage, path: str, **headers: str | None) -> tuple[int, bytes]:
    return request(page, path, **headers)[:2]


def values(page: WatchPage) -> dict[str, Any]:
    return json.loads(get(page, "/state.json")[1])


@contextmanager
def streamed(page: WatchPage) -> Iterator[socket.socket]:
    """Open the stream of a page as a browser does."""
    with socket.create_connection(("127.0.0.1", page.process.port), timeout=waiting.LIMIT_S) as client:
        client.sendall(b"GET /stream HTTP/1.0\r\nHost: localhost\r\n\r\n")
        yield client


def test_page_shows_the_newest_values(page: WatchPage) -> None:
    assert b"SIMULATED trial &lt;b&gt;" in get(page, "/")[1]
    sender = Sender([page.listener])
    sender.send("figures", {**LIFT, **FIGURES})
    sender.send("frame", {**LIFT, "serial": "D1/x", "time_ns": 5}, JPEG)
    until(lambda: bool(values(page)["pictures"]))
    sender.close()
    seen = values(page)
    assert seen["lifts"] == [
        {"title": "t1 wrench lift 2", "phase": "B", "estimate_deg": -3.14, "truth_deg": -3.06,
         "frames": "frames/s D1 60; dropped 2", "estimate": [[0.0, -3.0]], "truth": [[0.0, -3.06]]}
    ]  # fmt: skip
    assert (seen["done"], seen["total"], seen["what"], seen["ended"]) == (1, 5, "lifts", "")
    assert get(page, "/picture/D1%2Fx.jpg?1") == (200, JPEG)


def test_question_is_shown_until_answered_and_faults_stay(page: WatchPage) -> None:
    with observed_by(page.show_event):
        with announce_question("Place object t1 on its mark. Ready?"):
            assert values(page)["question"] == "Place object t1 on its mark. Ready?"
        assert values(page)["question"] == ""
        progress = announcing(lambda *_: None, lambda row: f"a {row}", lambda row: "it fell" if row else None)
        progress(2, 5, "")
        progress(3, 5, "lift")
        seen = values(page)
        assert (seen["done"], seen["newest"], seen["ended"]) == (3, "a lift", "")
        (fault,) = seen["faults"]
        assert fault.endswith(" it fell")
    assert values(page)["ended"] == "done"
    with pytest.raises(OperatorStopError), observed_by(page.show_event):
        raise OperatorStopError("stopped by the operator")
    assert values(page)["ended"] == "stopped by the operator"
    announce(Event("fault", "without observers"))
    assert len(values(page)["faults"]) == 1
    assert [text.partition(" ")[0] for text in values(page)["finished"]] == ["3/5", "2/5"]


@NEEDS_CHROMIUM
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_browser_shows_live_updates(page: WatchPage, tmp_path: Path, width: int, scheme: str) -> None:
    black = encode_jpeg(np.zeros((8, 6, 3), np.uint8), 80)
    browser = Browser(tmp_path / "profile")
    sender = Sender([page.listener])
    try:
        browser.open(page.address, width, scheme)

        def shown(what: str) -> bool:
            return what in browser.value("document.body.innerText")

        later = [(100_000_000 * n, -0.1 * n, 0.2) for n in range(1, 31)]
        sender.send("figures", {**LIFT, **FIGURES, "estimate": later})
        sender.send("frame", {**LIFT, "serial": "D1", "time_ns": 5}, black)
        page.show_event(Event("fault", "<i>fell</i>"))
        page.show_event(Event("question", "Place it. Ready?"))
        until(lambda: shown("Place it. Ready?") and shown("<i>fell</i>") and shown("t1 wrench lift 2"))
        assert shown("\u22123.0\u00b0")
        assert (
            browser.value(
                "document.querySelector('.curve path.estimate').getAttribute('d').match(/L/g).length"
            )
            == 29
        )
        box = browser.value(
            "(({width, height}) => [width, height])(document.querySelector('.curve').getBoundingClientRect())"
        )
        assert box[0] > 300
        assert box[1] > 100
        until(lambda: browser.value("document.querySelector('#pictures img')?.naturalHeight") == 8)
        page.show_event(Event("end", "done"))
        until(lambda: not shown("Place it. Ready?") and shown("The command has ended"))
        assert browser.value("document.documentElement.scrollWidth - innerWidth") <= 0
        report = tmp_path / "report.html"
        report.write_text("<!doctype html><title>t</title><p>the report</p>")
        page.show_report(report)
        until(lambda: browser.value("document.body.innerText") == "the report")
        assert browser.said() == []
    finally:
        browser.close()
        sender.close()


def test_page_is_read_only_and_serves_only_its_own_paths_to_its_own_host(still_page: WatchPage) -> None:
    own = f"http://{urlsplit(still_page.address).netloc}"
    assert urlsplit(still_page.address).query == "", "no key is needed on this computer"
    for status, path, method, headers in (
        (200, "/", "GET", {}),
        *((405, "/state.json", method, {}) for method in ("POST", "PUT", "DELETE", "PATCH", "HEAD")),
        *((404, path, "GET", {}) for path in ("/nope", "/picture/D9.jpg", "/picture/../watch.html")),
        *((404, path, "GET", {}) for path in ("/index.html", "/state.json/", "/past/", "/past/D9/0")),
        *((404, path, "GET", {}) for path in ("/past/D9/..%2F0", "/past/0", "/past//0", "/past/%00/%B2")),
        (403, "/state.json", "GET", {"Host": "evil.example:80"}),
        (200, "/state.json", "GET", {"Host": "localhost:9000"}),
        (403, "/state.json", "GET", {"Origin": "http://evil.example"}),
        (200, "/state.json", "GET", {"Origin": own}),
    ):
        assert request(still_page, path, method, **headers)[0] == status, (path, method, headers)


@pytest.fixture(scope="module", params=[None, "0.0.0.0:0"], ids=["for this computer", "for others"])
def acting_page(request: pytest.FixtureRequest) -> Iterator[WatchPage]:
    """A page with buttons."""
    made = WatchPage(watch_address(request.param), "rig live D1", estimators=["slip"])
    yield made
    made.close()


def pressed(page: WatchPage, body: bytes = b"estimator slip", **headers: str | None) -> int:
    """Press a button of a page with a request of our own; return the answer's status."""
    return request(page, "/do", "POST", body, **headers)[0]


NOT_OFFERED = (
    b"estimator lab:X", b"estimator builtins:dict", b"estimator", b"estimator  slip", b"estimator SLIP",
    b"estimator toskov", b"estimator\n", b"looking", b"report shown", b"record\xff", b"estimator\x00slip",
    b"mark", b"mark 1", b"mark 1.5", b"mark -1.000000", b"mark 1.000000\n", b"mark 12345678901.000000",
    b"mark nan", "mark \u0661.000000".encode(), b"mark  1.000000", b"Mark 1.000000", b"saved",
)  # fmt: skip


def test_button_needs_its_own_name_and_no_other_site_can_press_it(
    acting_page: WatchPage, still_page: WatchPage
) -> None:
    at = f"127.0.0.1:{acting_page.process.port}"
    *_, headers = request(acting_page, f"/?{urlsplit(acting_page.address).query}")
    assert headers["X-Frame-Options"] == "DENY"
    cookie, elsewhere = (headers["Set-Cookie"] or "").split(";")[0] or None, "rebound.example.org:80"
    refusals: list[dict[str, Any]] = [
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Host": elsewhere, "Origin": f"http://{elsewhere}"},
        {"body": b""},
        {"body": b"x" * 300},
        *({"body": body} for body in NOT_OFFERED),
    ]
    for refused in refusals:
        for sent in (None, *([] if "Host" in refused else [cookie])):  # no browser has one for elsewhere
            assert pressed(acting_page, **refused, Cookie=sent) == 403, refused
    assert acting_page.take_action() is None
    assert pressed(acting_page, Host=at, Origin=f"http://{at}", Cookie=cookie) == 200
    until(lambda: acting_page.take_action() == "estimator slip")
    for action in ("save", "mark 12.345678"):
        assert pressed(acting_page, action.encode(), Cookie=cookie) == 200
        until(lambda action=action: acting_page.take_action() == action)
    assert pressed(still_page) == 405


@pytest.mark.parametrize("estimators", [["slip"], []], ids=["buttons", "read-only"])
def test_page_for_other_computers_needs_the_key_that_is_printed(estimators: list[str]) -> None:
    made = WatchPage(watch_address("0.0.0.0:0"), "rig live D1", estimators=estimators)
    try:
        key = urlsplit(made.address).query.removeprefix("key=")
        assert len(key) >= 16
        paths = [
            "/",
            "/state.json",
            "/clock",
            "/stream",
            "/report.html",
            "/picture/D1.jpg",
            "/past/D1/0",
            "/do",
        ]
        guesses = ["", "?key=", f"?key={key[:-1]}", f"?Key={key}", f"?key={key}&key=x", f"?{key}"]
        for path in [path + guess for path in paths for guess in guesses]:
            status, body = get(made, path)
            assert (status, key.encode() in body) == (403, False), path
        port = made.process.port
        for cookie in ("", f"rig-{port}-key=", f"rig-{port}-key={key[:-1]}", f"other={key}", key):
            assert get(made, "/state.json", Cookie=cookie)[0] == 403, cookie
        status, html = get(made, f"/?key={key}")
        assert (status, key.encode() in html) == (200, False)
        assert get(made, f"/state.json?key={key}")[0] == 200
        assert get(made, "/state.json", Cookie=f"a=b; rig-{port}-key={key}")[0] == 200
    finally:
        made.close()


@NEEDS_CHROMIUM
def test_browser_shows_a_page_for_other_computers_and_presses_its_buttons(tmp_path: Path) -> None:
    made = WatchPage(watch_address("0.0.0.0:0"), "rig live D1", estimators=["slip"])
    browser = Browser(tmp_path / "profile")
    sender = Sender([made.listener])
    try:
        at = urlsplit(made.address)
        browser.open(f"http://127.0.0.1:{at.port}/?{at.query}", 1280, "light")
        until(lambda: browser.value("live.records") > 0)
        black = encode_jpeg(np.zeros((8, 6, 3), np.uint8), 80)
        sender.send("frame", {**LIFT, "serial": "D1", "time_ns": 5}, black)
        until(lambda: browser.value("document.querySelector('#pictures img')?.naturalHeight") == 8)
        browser.value("document.querySelector('[data-do=reference]').click()")
        until(lambda: made.take_action() == "reference")
        browser.open(f"http://127.0.0.1:{at.port}/", 1280, "light")
        until(lambda: browser.value("document.cookie === '' && !!document.getElementById('said')"))
    finally:
        browser.close()
        sender.close()
        made.close()


def state_of(came: list[Message]) -> WatchState:
    """Return the state of a page to which these messages come; it takes them from the list."""
    return WatchState(Progress("a", "lifts", 0, 1), lambda: [came.pop(0) for _ in range(len(came))])


def reading(time_s: float, picture: bytes) -> Message:
    values = {
        "sender": 1, "sensor": "D1", "t_s": time_s, "angle_deg": 1.5, "sigma_deg": 0.1, "zero_s": None,
        "dropped": 0, "rate_deg_s": None, "state": "tracking", "slip": False, "background": "", "outline": [],
    }  # fmt: skip
    return Message("sensor", values, picture)


def test_stream_sends_each_reading_and_picture_once() -> None:
    came: list[Message] = []
    state = state_of(came)

    def record(news: StateNews) -> tuple[dict[str, Any], bytes]:
        data = news()
        head, pictures = RECORD_HEAD.unpack(data[:8])
        assert len(data) == 8 + head + pictures
        return json.loads(data[8 : 8 + head]), data[8 + head :]

    news = StateNews(state)
    came += [reading(0.1 * n, JPEG + bytes([n])) for n in range(5)]
    came.append(Message("notice", {"sender": 1, "text": "reference taken"}))
    first = record(news)
    assert first[0]["notice"] == "reference taken"
    (sensor,) = first[0]["sensors"]
    assert [point[0] for point in sensor["points"]] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert (sensor["bytes"], first[1]) == (len(JPEG) + 1, JPEG + bytes([4]))
    assert news() == b"", "nothing is new"
    state.progress = state.progress.after(Event("end", "done"))
    ended = record(news)
    assert (ended[0]["ended"], ended[0]["sensors"][0]["points"], ended[1]) == ("done", [], b"")
    came.append(reading(0.5, JPEG))
    later = record(news)
    assert len(later[0]["sensors"][0]["points"]) == 1
    assert later[1] == JPEG
    other = record(StateNews(state))
    assert len(other[0]["sensors"][0]["points"]) == 6, "a page opened later has the curve so far"


def test_history_is_kept_without_a_browser_and_its_images_are_served(page: WatchPage) -> None:
    sender, count = Sender([page.listener]), KEPT_MESSAGES + 200

    def sent(values: dict[str, Any], picture: bytes = b"") -> bool:
        lost = sender.lost
        sender.send("sensor", values, picture)
        return sender.lost == lost

    until(lambda: sent({**reading(0.0, JPEG).values, "sensor": "left/1"}, JPEG))
    for number in range(count):
        if number % 100 == 0:
            time.sleep(2 * READ_EVERY_S)  # a sensor sends no faster than its frames
        until(lambda time_s=number / 60: sent(reading(time_s, b"").values))
    sender.close()
    with streamed(page) as client:
        received = b""
        while f'"t_s": {(count - 1) / 60}'.encode() not in received:
            received += client.recv(65_536)
    rest, times_s = received[received.index(b"\r\n\r\n") + 4 :], list[float]()
    while len(rest) >= 8 and len(rest) >= 8 + sum(sizes := RECORD_HEAD.unpack(rest[:8])):
        for one in json.loads(rest[8 : 8 + sizes[0]])["sensors"]:
            times_s += [point[0] for point in one["points"] if one["sensor"] == "D1"]
        rest = rest[8 + sum(sizes) :]
    assert len(set(times_s)) >= count - 1, "all but the newest, whose record may not be complete"
    status, past = get(page, "/past/left%2F1/0")
    assert (status, past[-len(JPEG) :]) == (200, JPEG)
    assert json.loads(past[8 : -len(JPEG)]) == {"t_s": 0.0, "outline": []}
    assert [get(page, f"/past/{path}")[0] for path in ("left%2F1/1", "left/1/0", "D1/0", "D1/x")] == [
        404, 200, 404, 404,
    ]  # fmt: skip


def test_report_is_served_and_browsers_get_it_before_the_page_ends(tmp_path: Path) -> None:
    made = WatchPage(watch_address(None), "a", "lifts", 0, 1)
    assert get(made, "/report.html")[0] == 404
    report = tmp_path / "report.html"
    report.write_bytes(b"<!doctype html><p>the report</p>")
    made.show_report(report)
    until(lambda: values(made)["report"] == str(report))
    with streamed(made) as client:
        assert client.recv(15) == b"HTTP/1.1 200 OK"
        received = b""
        while b"report.html" not in received:  # the first news: by then the page knows that a browser looks
            received += client.recv(4096)
        fetched: list[tuple[int, bytes]] = []
        later = threading.Timer(0.2, lambda: fetched.append(get(made, "/report.html")))
        later.start()
        made.close()
        later.join()
    assert fetched == [(200, report.read_bytes())]


def test_stream_ends_when_the_page_is_closed() -> None:
    made = WatchPage(watch_address(None), "a")
    with streamed(made) as client:
        received = client.recv(65_536)
        while b"\r\n\r\n" not in received or not received.endswith(b"}"):
            received += client.recv(65_536)
        assert b"Content-Length" not in received
        made.close()
        while client.recv(65_536):
            pass


def page_process() -> BaseProcess:
    """Return the process of the page that was served last."""
    pages = (each for each in multiprocessing.active_children() if each.name == "page")
    return max(pages, key=lambda page: page.pid or 0)


def test_page_server_has_low_priority_and_limits_requests(page: WatchPage) -> None:
    assert get(page, "/state.json")[0] == 200
    nice, own = (os.getpriority(os.PRIO_PROCESS, pid) for pid in (page_process().pid or 0, 0))
    assert nice == min(own + 10, 19)
    asked, began = int(BURST + MOST_PER_S), time.monotonic()
    for _ in range(asked):
        get(page, "/state.json")
    assert time.monotonic() - began > 0.7 * (asked - BURST) / MOST_PER_S


@pytest.mark.heavy
def test_suspended_page_delays_nothing_and_catches_up_later(page: WatchPage) -> None:
    assert get(page, "/state.json")[0] == 200
    process = page_process()
    assert process.pid
    os.kill(process.pid, signal.SIGSTOP)
    other = Inbox(f"{Path(page.listener.address).parent}/other")
    sender = Sender([page.listener, Listener(other.address, pictures=True)])
    began = time.monotonic()
    for number in range(2000):
        page.show_event(Event("fault", "it fell"))
        sender.send("frame", {**LIFT, "serial": "D1", "time_ns": number}, JPEG * 1000)
    assert time.monotonic() - began < waiting.LIMIT_S
    until(lambda: bool(other.take()))
    assert sender.lost > 0
    os.kill(process.pid, signal.SIGCONT)
    until(lambda: len(values(page)["faults"]) == KEPT_FAULTS)
    page.show_event(Event("question", "Ready?"))
    until(lambda: values(page)["question"] == "Ready?")
    sender.send("frame", {**LIFT, "serial": "D1", "time_ns": 1}, JPEG)
    until(lambda: len(other.take()) > 0)
    sender.close()
    other.close()


def test_stopped_page_is_ended_with_the_command_and_an_ended_one_changes_nothing(page: WatchPage) -> None:
    stopped = WatchPage(watch_address(None), "a")
    process = page_process()
    assert process.pid
    os.kill(process.pid, signal.SIGSTOP)
    stopped.close()
    assert not process.is_alive()
    page_process().kill()
    page_process().join(10)
    page.show_event(Event("question", "Ready?"))
    sender = Sender([page.listener])
    sender.send("frame", {**LIFT, "serial": "D1", "time_ns": 1}, JPEG)
    sender.close()


def test_page_ends_with_a_killed_command(tmp_path: Path) -> None:
    code = """if True:
        import multiprocessing, time
        from rig.live.watch import READ_EVERY_S, WatchPage, watch_address
        if __name__ == "__main__":
            page = WatchPage(watch_address(None), "a", "lifts", 0, 1)
            print(multiprocessing.active_children()[0].pid, page.address, flush=True)
            time.sleep(60)
    """
    (tmp_path / "program.py").write_text(code)
    with subprocess.Popen(
        [sys.executable, tmp_path / "program.py"], stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        pid, address = program.stdout.readline().split()
        at = urlsplit(address)
        with socket.create_connection((str(at.hostname), at.port or 0)) as client:
            client.sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
            assert client.recv(15) == b"HTTP/1.1 200 OK"
        program.kill()
    until(lambda: not Path(f"/proc/{pid}").exists() or " Z " in Path(f"/proc/{pid}/stat").read_text())


def test_page_keeps_only_the_newest_values() -> None:
    came = [Message("frame", {**LIFT, "serial": "D1", "time_ns": n}, JPEG + bytes([n])) for n in range(9)]
    came += [Message("frame", {**LIFT, "sender": 8, "serial": "D1", "time_ns": 9}, b"another process's")]
    came += [Message("phase", {**LIFT, "sender": n, "number": n, "phase": "A"}) for n in range(40)]
    state = state_of(came)
    for number in range(2 * KEPT_FAULTS):
        state.progress = state.progress.after(Event("fault", f"fault {number}"))
    assert state.picture("D1") == JPEG + bytes([8])
    seen = state.values()
    assert [lift["title"] for lift in seen["lifts"]] == ["t1 wrench lift 2"] * 16
    assert len(seen["faults"]) == KEPT_FAULTS
    assert seen["faults"][0].endswith(f"fault {2 * KEPT_FAULTS - 1}")


def test_angle_curve_has_screen_resolution() -> None:
    def figures(first: int) -> Message:
        frames = range(first, first + 60)
        answers = [(n * 16_666_667, None if n == 30 else n / 10, 0.2) for n in frames]
        return Message("figures", {**LIFT, **FIGURES, "time_ns": 0, "estimate": answers, "truth": []})

    came = [figures(0), figures(60)]
    state = state_of(came)
    (lift,) = state.values()["lifts"]
    times = [time_s for time_s, _ in lift["estimate"]]
    assert times == sorted(times)
    assert 35 <= len(times) <= 44
    assert lift["estimate"].count((0.5, None)) == 1, "a gap stays one"
    assert lift["truth"] == []
    came += [figures(60 * second) for second in range(2, 100)]
    (lift,) = state.values()["lifts"]
    assert len(lift["estimate"]) == KEPT_POINTS
    assert lift["estimate"][-1][0] == pytest.approx(100.0, abs=0.06), "the newest stay"


@pytest.mark.heavy
def test_invalid_address_and_address_in_use_are_rejected(still_page: WatchPage) -> None:
    for text in ("8080", ":8080", "host", "host:", "host:99999", "host:-1", "host:1e3", "h:²"):
        with pytest.raises(InputError, match="write host and port"):
            watch_address(text)
    for each in (watch_address(urlsplit(still_page.address).netloc), ("a..b", 0)):
        with pytest.raises(InputError, match=r"nothing can be served there .*; choose another address"):
            WatchPage(each, "a", "lifts", 0, 1)
