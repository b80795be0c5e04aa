"""The local page on which a person draws lines, served only on the loopback until labels are written."""

import json
from functools import partial
from http import HTTPStatus
from typing import Any

from drivers.errors import InputError, RigError
from drivers.formats import parse_json
from drivers.images import encode_png
from rig.frames.clips import LABELS
from rig.labels.angle_lines import (
    PASSES,
    Click,
    ClipToLabel,
    LineLog,
    angle_labels,
    difference,
    ends_in,
    labels_csv,
)
from rig.pages.page import render
from rig.pages.requests import LOOPBACK, NOT_FOUND, Answer, Request
from rig.pages.serving import PageProcess
from rig.sessions.files import write_file

MOST_BYTES = 1000
"""Size limit of a request; a click has about a hundred bytes."""


class AngleServer:
    """Serves the page of one clip from a separate process, until labels are written or it is closed.

    log: stores the clicks; `labels.csv` is written beside its file. address: URL of the page, with its key. A
    context manager: the server stops at its end.
    """

    def __init__(self, clip: ClipToLabel, log: LineLog) -> None:
        self._process = PageProcess(partial(AnglePage, clip, log), (LOOPBACK, 0), keyed=True)
        self.address = f"http://{LOOPBACK}:{self._process.port}/?{self._process.access.query}"

    def __enter__(self) -> "AngleServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.close()

    def labels_written(self, timeout_s: float) -> int | None:
        """Wait for labels; return their number, or None after the timeout. Raises `RigError`."""
        report = self._process.receive(timeout_s)
        return None if report is None else int(report)


class AnglePage:
    """The page's request handler, in the server's process."""

    def __init__(self, clip: ClipToLabel, log: LineLog) -> None:
        self._clip, self._log = clip, log
        self._html = render("rig.labels", "angle_page.html").encode()

    def answer(self, request: Request) -> Answer:
        """Answer a request for the page, for data on the clip or for an image, or store a click."""
        path = request.path.removeprefix("/")
        if request.method == "GET" and path == "":
            return Answer(self._html, "text/html; charset=utf-8")
        if request.method == "GET":
            if path != "clip":
                return self._picture(path)
            choice, (width, height) = self._clip.choice, self._clip.size_px
            known = {"name": self._clip.name, "frames": choice.frames, "reference": choice.reference}
            return _json({**known, "width": width, "height": height, "state": self._state()})
        if request.method == "POST" and path in ("click", "undo", "write"):
            return self._act(path, request.body)
        return NOT_FOUND

    def take(self, message: bytes) -> None:
        """Ignore messages of the main process, which sends none."""

    def close(self) -> None:
        """Release nothing: every click is on disk."""

    def _state(self) -> dict[str, Any]:
        """Return the ends of all lines by pass and frame, and pass and frame of the last click."""
        clicks = self._log.clicks
        last = [clicks[-1].drawn_in, clicks[-1].frame] if clicks else None
        return {"ends": [ends_in(clicks, drawn_in) for drawn_in in range(PASSES)], "last": last}

    def _picture(self, path: str) -> Answer:
        """Return a frame or its difference as PNG."""
        kind, _, name = path.partition("/")
        number = name.removesuffix(".png")
        known = number.isascii() and number.isdecimal() and len(number) < 9
        image = self._clip.frames.get(int(number)) if known else None
        if image is None or kind not in ("frame", "difference"):
            return NOT_FOUND
        shown = image if kind == "frame" else difference(image, self._clip.background)
        return Answer(encode_png(shown), "image/png")

    def _act(self, what: str, sent: bytes) -> Answer:
        """Carry out an action of the page: `click`, `undo` or `write`."""
        try:
            if len(sent) > MOST_BYTES:
                raise InputError("the request is too long: load the page again")
            if what == "write":
                return self._write()
            if what == "click":
                self._log.add(_click(sent))
            else:
                self._log.undo()
        except RigError as error:
            return _json({"error": str(error)}, HTTPStatus.BAD_REQUEST)
        return _json(self._state())

    def _write(self) -> Answer:
        reference = self._clip.choice.reference
        labels = angle_labels(self._log.passes(), reference)
        file = self._log.file.with_name(LABELS)
        write_file(file, labels_csv(labels, reference).encode())
        rows = [[label.frame, label.angle_deg, label.sigma_deg] for label in labels]
        left_out = len(self._clip.frames) - len(rows)
        report = str(len(rows)).encode()
        return _json({"file": str(file), "labels": rows, "left_out": left_out}, report=report)


def _json(value: dict[str, Any], status: HTTPStatus = HTTPStatus.OK, report: bytes = b"") -> Answer:
    return Answer(json.dumps(value).encode(), "application/json", status, report)


def _click(sent: bytes) -> Click:
    """Read a click: {"drawn_in": 0, "frame": 12, "x": 31.5, "y": 80}. Raises `InputError`."""
    value = parse_json(sent, "the click")
    try:
        return Click(int(value["drawn_in"]), int(value["frame"]), float(value["x"]), float(value["y"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"the click cannot be read ({error}): load the page again") from error
