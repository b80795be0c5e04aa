"""What is done to a frame each time a network in training sees it.

Colours keep their order and nothing is mirrored: where each LED stands is what the networks
learn shading from (measured on real frames: flips cost 0.06 to 0.14 IoU).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image

Planes = NDArray[np.float32]

SHADED_SHARE, PART_SHARE = 0.4, 0.35
"""Of the frames that are varied: under dark corners; near enough that borders cut contacts."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """One labelled frame: frame and background (h, w, 3) uint8 RGB, label (h, w) uint8."""

    frame: Image
    background: Image
    label: Image


def augmented(sample: LabelledFrame, ghost: Image, varied: bool, rng: np.random.Generator) -> LabelledFrame:
    """Return the sample under other light, noise, place and scale.

    ghost: another frame of the same unit, which may shine faintly through the background, as
    contacts do that a background made from frames was not rid of. varied: whether corners and sides
    may lie in the dark, and a frame may show a part of the gel only: for networks that are to carry
    over to sensors of another make.
    """
    frame, background = sample.frame.astype(np.float32), sample.background.astype(np.float32)
    if varied and rng.random() < SHADED_SHARE:
        shade = _shade(frame.shape[:2], rng)
        frame, background = frame * shade, background * shade
    if rng.random() < 0.25:
        background += np.float32(rng.uniform(0.05, 0.30)) * (ghost.astype(np.float32) - background)
    frame, background = _relit(frame, background, rng)
    images, label = [_bytes(frame), _bytes(background)], sample.label
    if rng.random() < 0.6:
        images, label = _moved(images, label, varied, rng)
    if rng.random() < 0.4:
        blur_px = float(rng.uniform(0.3, 1.5))
        images = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8) for image in images]
    return LabelledFrame(images[0], images[1], label)


def _relit(frame: Planes, background: Planes, rng: np.random.Generator) -> tuple[Planes, Planes]:
    """Drift between background and frame, another exposure of both, noise, and smooth patches of light."""
    both = np.exp(rng.normal(0.0, 0.2, 3)).astype(np.float32)
    drift = np.exp(rng.normal(0.0, 0.06, 3)).astype(np.float32)
    frame = np.asarray(frame * (drift * both) + rng.normal(0.0, 1.5, 3), np.float32)
    noise = rng.standard_normal(frame.shape, np.float32)
    frame += np.float32(rng.uniform(0.0, 2.5)) * noise
    if rng.random() < 0.4:
        coarse = rng.standard_normal((int(rng.integers(3, 9)), int(rng.integers(3, 7)), 3), np.float32)
        patches = cv2.resize(coarse, frame.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        frame *= 1.0 + np.float32(rng.uniform(0.0, 0.06)) * patches
    return frame, background * both


def _shade(shape: tuple[int, ...], rng: np.random.Generator) -> Planes:
    """Return the share of light (h, w, 1) under dark corners and sides, as gels have at their edges."""
    coarse = 1.0 - np.float32(rng.uniform(0.3, 0.85)) * rng.random((3, 3), np.float32) ** 2
    smooth = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth, np.float32)[..., None]


def _moved(
    images: list[Image], label: Image, parts: bool, rng: np.random.Generator
) -> tuple[list[Image], Image]:
    """Shift and scale all alike, mirroring what comes in at the border; some to a part, if `parts`."""
    rows, columns = label.shape
    zoom = float(np.exp(rng.uniform(-0.15, 0.20)))
    reach = 0.08
    if parts and rng.random() < PART_SHARE:
        # so near that only a part of the gel is seen: borders cut contacts anywhere
        zoom = float(rng.uniform(1.15, 1.7))
        reach = (zoom - 1.0) / 2.0
    across, down = rng.uniform(-reach, reach, 2) * (columns, rows)
    change = np.array(
        [
            [zoom, 0.0, (1.0 - zoom) * columns / 2 + across],
            [0.0, zoom, (1.0 - zoom) * rows / 2 + down],
        ]
    )
    moved = [
        np.asarray(cv2.warpAffine(image, change, (columns, rows), borderMode=cv2.BORDER_REFLECT), np.uint8)
        for image in (*images, label)
    ]
    return moved[:-1], moved[-1]


def _bytes(image: Planes) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
