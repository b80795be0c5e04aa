"""Labelled images from a folder, brought into memory at the size that networks see."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.errors import InputError, counted
from drivers.images import read_image
from drivers.types import Image
from rig.labels.datasets import LabelledFile, read_dataset
from rig.sessions.layout import REFERENCES
from rig.tactile.contact.background import MAX_FRAMES, MIN_FRAMES, auto_background
from rig.training.examples import Examples, sized


def folder_examples(
    folder: Path, size: tuple[int, int], progress: Callable[[int, int], None] = lambda done, total: None
) -> Examples:
    """Read all labelled images under a folder at (width, height) `size`. Raises `InputError`.

    Where the data has no frame without contact, one is made from each group's own frames.
    """
    files = read_dataset(folder)
    made: dict[str, Image] = {}
    frames, backgrounds, labels = [], [], []
    for number, file in enumerate(files):
        image = read_image(file.image)
        frames.append(sized(image, size))
        labels.append(sized(file.label(image.shape[:2]), size))
        if file.group not in made:
            made[file.group] = _background(file, files, size)
        backgrounds.append(made[file.group])
        progress(number + 1, len(files))
    return Examples(
        np.stack(frames),
        np.stack(backgrounds),
        np.stack(labels),
        tuple(file.object_id for file in files),
        any(file.simulated for file in files),
    )


def _background(file: LabelledFile, files: list[LabelledFile], size: tuple[int, int]) -> Image:
    if file.background is not None:
        return sized(read_image(file.background), size)
    group = [other.image for other in files if other.group == file.group]
    if len(group) < MIN_FRAMES:
        raise InputError(
            f"{file.group}: {counted(len(group), 'image')} cannot make a frame without contact: put one in "
            f"{Path(file.group) / REFERENCES}"
        )
    spread = np.unique(np.linspace(0, len(group) - 1, MAX_FRAMES).round().astype(int))
    return auto_background([sized(read_image(group[i]), size) for i in spread])
