"""Simulated frames with their labels, in memory at the size that networks see."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from drivers.types import Image
from fakes.studio.training_frames import TrainingFrame, training_frames
from rig.labels.outline import contact_label
from rig.training.examples import Examples, sized


def simulated_examples(
    objects: Sequence[str],
    count: int,
    seed: int,
    size: tuple[int, int],
    random_share: float = 0.0,
    family: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> Examples:
    """Render labelled frames (see `fakes.studio.training_frames`).

    size: (width, height) in px that frames are kept at. The same seed gives the same frames.
    """
    return examples_of(training_frames(objects, seed, random_share, family), count, size, progress)


def examples_of(
    units: Iterable[Sequence[TrainingFrame]],
    count: int,
    size: tuple[int, int],
    progress: Callable[[int], None] = lambda done: None,
) -> Examples:
    """Keep the first so many frames of units, at (width, height) `size`."""
    frames, backgrounds, labels, ids = [], [], [], []
    for unit in units:
        for shown in unit:
            frames.append(sized(shown.image, size))
            backgrounds.append(sized(shown.background, size))
            labels.append(sized(_label(shown), size))
            ids.append(shown.object_id)
        progress(min(len(frames), count))
        if len(frames) >= count:
            break
    kept = slice(count)
    return Examples(
        np.stack(frames[kept]), np.stack(backgrounds[kept]), np.stack(labels[kept]), tuple(ids[kept]), True
    )


def _label(shown: TrainingFrame) -> Image:
    if shown.touching is None:
        return np.zeros(shown.image.shape[:2], np.uint8)
    return contact_label(shown.touching)
