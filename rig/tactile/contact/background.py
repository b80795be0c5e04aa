"""Compute a frame without contact from frames that may all show contacts."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.finder import WORK_LONG_SIDE_PX, ContactFinder
from rig.tactile.sample import check_frame

# Number of frames used: more do not improve the median and need memory (60 DIGIT frames are 14 MB).
MAX_FRAMES = 60
MIN_FRAMES = 3
# Number of iterations of masking the contacts and computing the median of the rest; more change nothing.
PASSES = 4
# The result that started from the frame with the weakest edges is used only if its edges are weaker than
# those of the other result by this factor, because a frame may have weak edges because it is dark. Faint
# contacts that remain in the median raise the gradients by 2 %, large ones by 5 to 20 %.
PLAINER = 0.985
# Rows whose median is computed at once, which limits the memory of the sort.
ROWS_AT_ONCE = 32
MASKED = np.iinfo(np.int16).max


def mean_background(frames: Sequence[Image]) -> Image:
    """Return the mean of frames without contact, (H, W, 3) uint8 RGB. Raises `InputError`."""
    check_frames(frames, 1)
    total = np.zeros(frames[0].shape, np.float64)
    for frame in frames:
        total += frame
    return np.rint(total / len(frames)).astype(np.uint8)


def auto_background(frames: Sequence[Image]) -> Image:
    """Compute the frame without contact, (H, W, 3) uint8 RGB, from frames that may all show contacts.

    Every pixel has to be without contact in some frames, so contacts must change place, or be absent in some
    frames. Two initial backgrounds (the median of all frames, and the frame with the weakest edges) are
    refined by the median of the pixels outside the contacts. The second is returned if its edges are weaker,
    because a contact that remains in a background adds edges. At most 60 frames, evenly spread, are used.
    Raises `InputError` for fewer than 3 frames or mixed sizes.
    """
    check_frames(frames, MIN_FRAMES)
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), MAX_FRAMES)).round().astype(int))
    stack = np.stack([frames[i] for i in chosen])
    work = _reduce(stack)
    masks, rough = _refine(work, _median(work, None, work[0]))
    other_masks, other = _refine(work, min(work, key=structure))
    if structure(other) < PLAINER * structure(rough):
        masks, rough = other_masks, other
    height, width = stack.shape[1:3]
    full = np.stack([cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) for mask in masks])
    fallback = np.asarray(cv2.resize(rough, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    return _median(stack, full, fallback)


def check_frames(frames: Sequence[Image], least: int) -> None:
    """Raise `InputError` unless there are enough frames, all (H, W, 3) uint8 of one size."""
    if len(frames) < least:
        raise InputError(f"too few frames for a background ({len(frames)}): give {least} or an image")
    for frame in frames:
        check_frame(frame, frames[0].shape)


def structure(image: Image) -> float:
    """Return the strength of an image's edges, independent of light: the mean gradient of its logarithm."""
    logarithm = np.log(image.astype(np.float32) + 10.0)
    smooth = cv2.GaussianBlur(logarithm, (0, 0), 2.0)
    return float(np.abs(np.diff(smooth, axis=0)).mean() + np.abs(np.diff(smooth, axis=1)).mean())


def _reduce(stack: Image) -> Image:
    height, width = stack.shape[1:3]
    scale = min(1.0, WORK_LONG_SIDE_PX / max(height, width))
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    return np.stack([np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA)) for frame in stack])


def _refine(work: Image, guess: Image) -> tuple[Image, Image]:
    """Return the masks (N, h, w) of the contacts and the background (h, w, 3) after all iterations."""
    background = guess
    masks = np.zeros(work.shape[:3], np.uint8)
    for _ in range(PASSES):
        for mask, frame in zip(masks, work, strict=True):
            found = ContactFinder(background).find(frame).mask
            mask[...] = 0 if found is None else found
        background = _median(work, masks, background)
    return masks, background


def _median(stack: Image, masks: Image | None, fallback: Image) -> Image:
    """Return the median over frames of the pixels outside the masks.

    fallback: (H, W, 3), used for pixels that are masked in all frames.
    """
    result = np.empty(stack.shape[1:], np.uint8)
    for top in range(0, stack.shape[1], ROWS_AT_ONCE):
        rows = np.s_[top : top + ROWS_AT_ONCE]
        hidden = None if masks is None else masks[:, rows] > 0
        result[rows] = _median_rows(stack[:, rows], hidden, fallback[rows])
    return result


def _median_rows(stack: Image, hidden: NDArray[np.bool_] | None, fallback: Image) -> Image:
    values = stack.astype(np.int16)
    if hidden is None:
        return np.rint(np.median(values, axis=0)).astype(np.uint8)
    values[hidden] = MASKED
    values.sort(axis=0)
    seen = (~hidden).sum(axis=0)[None, :, :, None]
    low = np.take_along_axis(values, np.maximum(seen - 1, 0) // 2, axis=0)[0]
    high = np.take_along_axis(values, np.minimum(seen // 2, len(stack) - 1), axis=0)[0]
    middle = (low.astype(np.int32) + high + 1) // 2
    return np.where(seen[0] > 0, middle, fallback).astype(np.uint8)
