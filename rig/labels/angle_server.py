"""The local page on which a person draws lines: served on the loopback alone, until labels are written."""

import json
import secrets
import threading
from functools import partial
from http import HTTPStatus
from typing import Any

from drivers.errors import InputError, RigError
from drivers.formats import parse_json
from drivers.images import encode_png
from rig.frames.clips import LABELS
from rig.labels.angle_clicks import Click, LineLog, ends_in
from rig.labels.angle_clip import ClipToLabel, difference
from rig.labels.angle_lines import PASSES, AngleLabel, angle_labels, labels_csv
from rig.pages.page import render
from rig.pages.serving import PageHandler, PageServer
from rig.sessions.files import write_file

MOST_BYTES = 1000
"""A click is a hundred bytes."""


class AngleServer:
    """Serves one clip's page at `address`, which nobody can guess; `done` is set when labels are written.

    log: takes the clicks; `labels.csv` is written beside its file. A context manager: the page is gone when
    it ends.
    """

    def __init__(self, clip: ClipToLabel, log: LineLog) -> None:
        self.clip, self.log = clip, log
        self.token = secrets.token_urlsafe(12)
        self.done = threading.Event()
        self.labels: list[AngleLabel] = []
        self._server = PageServer(("127.0.0.1", 0), partial(_Handler, self))
        self.address = f"http://127.0.0.1:{self._server.port}/{self.token}/"

    def __enter__(self) -> "AngleServer":
        self._server.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def page(self) -> str:
        """Return the page."""
        choice, (width, height) = self.clip.choice, self.clip.size_px
        known = {"frames": choice.frames, "reference": choice.reference, "width": width, "height": height}
        known["state"] = self.state()
        return render("rig.labels", "angle_page.html", name=self.clip.name, known=known)

    def state(self) -> dict[str, Any]:
        """Return what is drawn: the ends of the lines of each pass by frame, and where the last click was."""
        clicks = self.log.clicks
        last = [clicks[-1].drawn_in, clicks[-1].frame] if clicks else None
        return {"ends": [ends_in(clicks, drawn_in) for drawn_in in range(PASSES)], "last": last}

    def picture(self, kind: str, number: int) -> bytes | None:
        """Return a frame or its difference as PNG; None for one that is not labelled."""
        image = self.clip.frames.get(number)
        if image is None or kind not in ("frame", "difference"):
            return None
        return encode_png(image if kind == "frame" else difference(image, self.clip.background))

    def take(self, what: str, sent: bytes) -> dict[str, Any]:
        """Do what the page asks for: `click`, `undo` or `write`. Raises `RigError`."""
        if what == "click":
            self.log.add(_click(sent))
        elif what == "undo":
            self.log.undo()
        else:
            return self._write()
        return self.state()

    def _write(self) -> dict[str, Any]:
        reference = self.clip.choice.reference
        self.labels = angle_labels(self.log.passes(), reference)
        file = self.log.file.with_name(LABELS)
        write_file(file, labels_csv(self.labels, reference).encode())
        rows = [[label.frame, label.angle_deg, label.sigma_deg] for label in self.labels]
        return {"file": str(file), "labels": rows, "left_out": len(self.clip.frames) - len(rows)}


class _Handler(PageHandler):
    def __init__(self, owner: AngleServer, *connection: Any) -> None:
        self._owner = owner
        super().__init__(*connection)

    def do_GET(self) -> None:  # noqa: N802 - as http.server calls it
        owner, path = self._owner, self._path()
        if path == "":
            self.answer(HTTPStatus.OK, "text/html; charset=utf-8", owner.page().encode())
            return
        kind, _, name = (path or "").partition("/")
        number = name.removesuffix(".png")
        picture = owner.picture(kind, int(number)) if number.isdecimal() and len(number) < 9 else None
        if picture is None:
            self.answer(HTTPStatus.NOT_FOUND, "text/plain", b"not here")
        else:
            self.answer(HTTPStatus.OK, "image/png", picture)

    def do_POST(self) -> None:  # noqa: N802 - as http.server calls it
        length, what = self.headers.get("Content-Length", ""), self._path()
        if what not in ("click", "undo", "write") or not length.isdecimal() or len(length) > 9:
            self.answer(HTTPStatus.NOT_FOUND, "text/plain", b"not here")
            return
        try:
            if int(length) > MOST_BYTES:
                raise InputError("what was sent is too long: load the page anew")
            status, said = HTTPStatus.OK, self._owner.take(what, self.rfile.read(int(length)))
        except RigError as error:
            status, said = HTTPStatus.BAD_REQUEST, {"error": str(error)}
        self.answer(status, "application/json", json.dumps(said).encode())
        if what == "write" and status is HTTPStatus.OK:
            self._owner.done.set()

    def _path(self) -> str | None:
        """Return the path behind the token; None without it."""
        start = f"/{self._owner.token}/"
        return self.path.removeprefix(start) if self.path.startswith(start) else None


def _click(sent: bytes) -> Click:
    """Read a click: {"drawn_in": 0, "frame": 12, "x": 31.5, "y": 80}. Raises `InputError`."""
    value = parse_json(sent, "the click")
    try:
        return Click(int(value["drawn_in"]), int(value["frame"]), float(value["x"]), float(value["y"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"the click cannot be read ({error}): load the page anew") from error
