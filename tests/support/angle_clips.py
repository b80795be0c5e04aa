"""A drawn clip with a rotation, and requests to its labelling page as a browser sends them."""

import json
import math
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

TURN_DEG = [*[0.0] * 4, *np.arange(5.0, 45.0, 5.0)]
"""Of the contact from frame 2 on; frames 0 and 1 are without one."""
START_DEG = 15.0
FIRST_CONTACT = 2
"""Reference of the labels: the object turns too soon after it for the contact to settle."""


def write_clip(folder: Path, press: Callable[..., NDArray[np.uint8]], blank: NDArray[np.uint8]) -> Path:
    """A folder with frames/ and background.png."""
    (folder / "frames").mkdir(parents=True)
    cv2.imwrite(str(folder / "background.png"), blank[..., ::-1])
    for number, turn in enumerate([None, None, *TURN_DEG]):
        image = press(None if turn is None else START_DEG + turn, (85, 25), seed=number)
        cv2.imwrite(str(folder / "frames" / f"{number:03d}.png"), image[..., ::-1])
    return folder


def true_ends(frame: int) -> list[tuple[float, float]]:
    """The ends of the contact's long axis in a frame, px."""
    angle = math.radians(START_DEG + TURN_DEG[frame - 2])
    x, y = 70.0 * math.cos(angle), 70.0 * math.sin(angle)
    return [(120.0 - x, 160.0 + y), (120.0 + x, 160.0 - y)]


def ask(address: str, path: str = "", data: Any = None, **headers: str) -> tuple[int, Any]:
    """GET, or POST if there is something to send; return the status and the answer, JSON as a value.

    address: of the page, with its key as the query.
    """
    page, _, key = address.partition("?")
    body = None if data is None else data if isinstance(data, bytes) else json.dumps(data).encode()
    asked = urllib.request.Request(f"{page}{path}?{key}", body, headers)
    try:
        with urllib.request.urlopen(asked, timeout=120) as answer:
            status, kind, text = answer.status, answer.headers["Content-Type"], answer.read()
    except urllib.error.HTTPError as error:
        status, kind, text = error.code, error.headers["Content-Type"], error.read()
    return status, json.loads(text) if kind == "application/json" else text


def draw_all(address: str, frames: list[int], shift_px: float = 0.0) -> None:
    """Draw the true lines of all frames in both passes, the second shifted."""
    for drawn_in in (0, 1):
        for frame in frames:
            for x, y in true_ends(frame):
                click = {"drawn_in": drawn_in, "frame": frame, "x": x, "y": y + drawn_in * shift_px}
                status, answer = ask(address, "click", click)
                assert status == 200, answer
