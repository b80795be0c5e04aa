"""Nine real DIGIT frames of one sensor with human labels, for scoring only; and the picture of them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import InputError
from drivers.images import read_image
from drivers.types import Image
from rig.tactile.contact.background import auto_background

FOLDER = Path("aurova_figures") / "panels"
COUNT = 9
_WHITE, _YELLOW = (255, 255, 255), (255, 235, 0)
_SCALE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Panels:
    """Frames (H, W, 3) uint8 RGB, their labels (H, W) uint8, 0 or 255, and a background made from them."""

    frames: list[Image]
    labels: list[Image]
    background: Image


def read_panels(data: Path) -> Panels | None:
    """Read the frames in a folder of real recordings; return None if it has none.

    Raises `InputError` for damaged ones.
    """
    folder = data / FOLDER
    if not folder.is_dir():
        return None
    frames = [read_image(folder / f"{number}_raw.png") for number in range(1, COUNT + 1)]
    read = [read_image(folder / f"{number}_label.png").max(axis=2) for number in range(1, COUNT + 1)]
    labels = [np.where(label > 127, 255, 0).astype(np.uint8) for label in read]
    if any(frame.shape[:2] != label.shape for frame, label in zip(frames, labels, strict=True)):
        raise InputError(f"{folder}: a label's size is not its frame's: copy the folder again")
    return Panels(frames, labels, auto_background(frames))


def panels_picture(panels: Panels, masks: dict[str, list[Image]]) -> Image:
    """Draw a row of frames per method: its outline yellow, the human label's white; (H, W, 3) uint8 RGB."""
    rows = []
    for method, found in masks.items():
        row = np.hstack(
            [
                _drawn(frame, label, mask)
                for frame, label, mask in zip(panels.frames, panels.labels, found, strict=True)
            ]
        )
        strip = np.full((26, row.shape[1], 3), 24, np.uint8)
        text = f"{method}: yellow; human label: white"
        cv2.putText(strip, text, (8, 19), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _WHITE, 1, cv2.LINE_AA)
        rows += [strip, row]
    return np.vstack(rows)


def _drawn(frame: Image, label: Image, mask: Image) -> Image:
    height, width = frame.shape[:2]
    size = (_SCALE * width, _SCALE * height)
    picture = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_CUBIC), np.uint8)
    for region, colour in ((label, _WHITE), (mask, _YELLOW)):
        large = cv2.resize(region.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours(large, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, colour, 1, cv2.LINE_AA)
    return picture
