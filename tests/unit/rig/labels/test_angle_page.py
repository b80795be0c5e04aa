"""The page on which lines are drawn: every click is kept, none is believed unseen."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.images import read_image
from rig.frames.estimates import Estimation
from rig.frames.series import read_frames
from rig.labels import angle_lines
from rig.labels.angle_lines import LINES, Click, ClipToLabel, FrameChoice, LineLog, choose_frames, read_drawn
from rig.labels.angle_server import AnglePage, AngleServer
from rig.pages.requests import Request
from rig.tactile.estimators import choose_estimator
from support.angle_clips import FIRST_CONTACT, ask, true_ends, write_clip

Image = NDArray[np.uint8]
Draw = Callable[..., Image]


@pytest.fixture
def clip(tmp_path: Path, press: Draw, blank: Image) -> Path:
    return write_clip(tmp_path / "clip", press, blank)


def opened(clip: Path, count: int = 4, reference: int = FIRST_CONTACT) -> ClipToLabel:
    series, background = read_frames(clip / "frames"), read_image(clip / "background.png")
    return angle_lines.load_clip(
        "clip", series, background, choose_frames(series, background, count, reference)[0]
    )


@pytest.fixture
def server(clip: Path) -> Iterator[AngleServer]:
    to_label = opened(clip)
    with AngleServer(to_label, LineLog(clip / LINES, to_label)) as running:
        yield running


class Asked:
    """The page, asked as its server asks it."""

    def __init__(self, clip: Path) -> None:
        self.clip = opened(clip)
        self.log = LineLog(clip / LINES, self.clip)
        self.page = AnglePage(self.clip, self.log)
        self.reports: list[bytes] = []

    def get(self, path: str) -> tuple[int, bytes]:
        answer = self.page.answer(Request("GET", path, {}))
        return answer.status, answer.body

    def post(self, what: str, data: object) -> tuple[int, Any]:
        body = data if isinstance(data, bytes) else json.dumps(data).encode()
        answer = self.page.answer(Request("POST", f"/{what}", {}, body))
        self.reports += [answer.report] if answer.report else []
        return answer.status, json.loads(answer.body) if answer.kind == "application/json" else answer.body


@pytest.fixture
def page(clip: Path) -> Asked:
    return Asked(clip)


@pytest.mark.heavy
def test_frames_are_chosen_evenly_from_the_first_contact_on(clip: Path) -> None:
    assert opened(clip).choice == FrameChoice(2, (2, 6, 9, 13))
    assert opened(clip, 100).choice.frames == tuple(range(2, 14))
    assert opened(clip, 3, reference=7).choice == FrameChoice(7, (7, 10, 13))


@pytest.mark.heavy
def test_proposes_the_zero_of_rig_estimate_as_reference(clip: Path, press: Draw, blank: Image) -> None:
    for number in range(2, 34):
        share = {2: 0.5, 3: 0.8}.get(number, 1.0)
        growing = press(15.0 + max(0, number - 20), (85 * share, 25 * share), seed=number)
        cv2.imwrite(str(clip / "frames" / f"{number:03d}.png"), growing[..., ::-1])
    series = read_frames(clip / "frames")
    choice, note = choose_frames(series, blank, 3)
    assert choice == FrameChoice(18, (18, 26, 33))
    assert "reference: frame 18 (at the first frame with an angle in a settled contact)" in note
    estimated = Estimation(choose_estimator(None, None), "first:2").of_series(series).figures
    assert estimated.reference_time_s == pytest.approx(choice.reference / 60, abs=1e-6)


@pytest.mark.heavy
def test_only_frames_of_the_press_with_the_reference_are_offered(clip: Path, blank: Image) -> None:
    for number in (6, 7, 8, 9):
        cv2.imwrite(str(clip / "frames" / f"{number:03d}.png"), blank[..., ::-1])
    assert opened(clip, 100).choice == FrameChoice(2, (2, 3, 4, 5))
    assert opened(clip, 2).choice == FrameChoice(2, (2, 5))
    assert opened(clip, 100, reference=10).choice == FrameChoice(10, (10, 11, 12, 13))
    note = choose_frames(read_frames(clip / "frames"), blank, 3)[1]
    assert "the reference is one of them, with 0 degrees" in note
    assert "the press ends at frame 6; label a later one" in note
    assert max(map(len, note.splitlines())) <= 100
    for number in (0, 7, 99):
        with pytest.raises(InputError, match=f"--reference {number} shows no contact .* in frames 2 to 13"):
            opened(clip, reference=number)
    with pytest.raises(InputError, match="no contact follows frame 5"):
        opened(clip, reference=5)
    grey = np.full((320, 240, 3), 90, np.uint8)
    for file in (clip / "frames").iterdir():
        cv2.imwrite(str(file), grey)
    with pytest.raises(InputError, match="no frame shows a contact: compare the background"):
        choose_frames(read_frames(clip / "frames"), grey, 3)


def test_page_sends_the_choice_of_frames_and_their_pictures(page: Asked) -> None:
    assert json.loads(page.get("/clip")[1])["frames"] == [2, 6, 9, 13]
    status, picture = page.get("/frame/6.png")
    decoded = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert (status, decoded is not None) == (200, True)
    assert (decoded[..., ::-1] == page.clip.frames[6]).all()  # type: ignore[index]
    assert page.get("/difference/6.png")[0] == 200
    for path in ("/frame/3.png", "/../../etc/passwd", "/frame/\u00b2.png", "/other/6.png", "/click"):
        assert page.get(path)[0] == 404, path


def test_page_needs_the_key_of_its_address(server: AngleServer) -> None:
    """Other names, other sites and cookies: `tests/unit/rig/test_watch.py`, for the same server."""
    assert b"How far has it turned" in ask(server.address)[1]
    page, _, key = server.address.partition("?key=")
    assert len(key) >= 16
    for address in (page, f"{page}?key=", f"{page}?key={key[:-1]}", f"{page}#{key}"):
        for path, data in (("", None), ("clip", None), ("frame/2.png", None), ("undo", {})):
            assert ask(address, path, data)[0] == 403


def test_clicks_are_on_disk_before_they_are_answered_and_taken_back_one_by_one(
    page: Asked, clip: Path
) -> None:
    for number, x in enumerate((10, 60, 20), 1):
        assert page.post("click", {"drawn_in": 0, "frame": 2, "x": x, "y": 50})[0] == 200
        kept = read_drawn(clip / LINES)
        assert kept is not None
        assert len(kept.clicks) == number
        assert not list(clip.glob("*.part"))
    for left in ({"2": [[10.0, 50.0], [60.0, 50.0]]}, {"2": [[10.0, 50.0]]}):
        assert page.post("undo", {})[1]["ends"][0] == left
    assert page.post("undo", {})[1] == {"ends": [{}, {}], "last": None}
    assert page.post("undo", {})[0] == 200


@pytest.mark.parametrize(
    "sent",
    [
        b"", b"[", b"[1]", b"null", b'{"drawn_in": 0}', b"{" * 600,
        {"drawn_in": 2, "frame": 2, "x": 1, "y": 1}, {"drawn_in": 0, "frame": 3, "x": 1, "y": 1},
        {"drawn_in": 0, "frame": 2, "x": 900, "y": 1}, {"drawn_in": 0, "frame": 2, "x": 1, "y": -50},
        {"drawn_in": 0, "frame": 2, "x": "left", "y": 1}, b'{"drawn_in":0,"frame":2,"x":NaN,"y":1}',
        b" " * 2000,
    ],
)  # fmt: skip
def test_invalid_click_is_rejected_and_not_stored(page: Asked, clip: Path, sent: object) -> None:
    status, answer = page.post("click", sent)
    assert status == 400
    assert answer["error"]
    assert not (clip / LINES).exists()


def test_labels_are_not_written_while_lines_are_missing(page: Asked, clip: Path) -> None:
    for x, y in true_ends(2):
        page.post("click", {"drawn_in": 0, "frame": 2, "x": x, "y": y})
    status, answer = page.post("write", {})
    assert status == 400
    assert "need a line in each of both passes" in answer["error"]
    assert page.reports == []
    assert not (clip / "labels.csv").exists()


def test_full_disk_is_reported_and_the_click_discarded(page: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rig.sessions.files.write_whole", full)
    status, answer = page.post("click", {"drawn_in": 0, "frame": 2, "x": 50, "y": 50})
    assert status == 400
    assert "No space left" in answer["error"]
    assert page.log.clicks == ()


def test_lines_that_were_begun_go_on_with_the_same_clip_only(clip: Path) -> None:
    to_label = opened(clip)
    log = LineLog(clip / LINES, to_label)
    log.add(Click(0, 2, 10.0, 20.0))
    log.add(Click(0, 2, 60.0, 20.0))
    again = LineLog(clip / LINES, to_label, read_drawn(clip / LINES))
    assert again.passes() == [{2: (10.0, 20.0, 60.0, 20.0)}, {}]
    again.undo()
    assert angle_lines.ends_in(again.clicks, 0) == {2: [(10.0, 20.0)]}
    content = json.loads((clip / LINES).read_text())
    (clip / LINES).write_text(json.dumps(content | {"size_px": [320, 240]}))
    with pytest.raises(InputError, match="of another size"):
        LineLog(clip / LINES, to_label, read_drawn(clip / LINES))


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"schema": 1}', "\x00", '{"schema": 1, "clicks": 5}'])
def test_a_damaged_file_of_lines_is_named_and_never_replaced(clip: Path, text: str) -> None:
    (clip / LINES).write_text(text)
    with pytest.raises(InputError, match="move the file away"):
        read_drawn(clip / LINES)
    assert (clip / LINES).read_text() == text
