"""Simulated frames as files, bit for bit: a folder of PNG, or a video in FFV1.

Both are lossless, unlike JPEG, so that the frames of a test are known exactly. A driver plays them at the
pace of its clock.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.types import Image
from fakes.wire.mjpeg.server import Render


def write_folder(folder: Path, render: Render, rate_hz: float, count: int) -> list[Path]:
    """Write `count` frames as frame_0000.png and so on, the first at time 0; return the files.

    render: draws the (H, W, 3) uint8 RGB image of a time in ns. Raises `InputError` when the
    folder cannot be written.
    """
    files = []
    for number, image in enumerate(_frames(render, rate_hz, count)):
        files.append(folder / f"frame_{number:04d}.png")
        if not cv2.imwrite(str(files[-1]), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
            raise InputError(f"{files[-1]}: cannot be written; is the folder there?")
    return files


def write_video(file: Path, render: Render, rate_hz: float, count: int) -> None:
    """Write `count` frames as an AVI in FFV1. Raises `InputError` when it cannot be written."""
    writer: cv2.VideoWriter | None = None
    for image in _frames(render, rate_hz, count):
        if writer is None:
            height, width = image.shape[:2]
            writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"FFV1"), rate_hz, (width, height))
            if not writer.isOpened():
                raise InputError(f"{file}: cannot be written; is the folder there?")
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    if writer is not None:
        writer.release()


def _frames(render: Render, rate_hz: float, count: int) -> Iterator[Image]:
    return (render(round(number * NS_PER_S / rate_hz)) for number in range(count))
