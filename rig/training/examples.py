"""Labelled frames in memory: from folders of labelled images, or rendered."""

import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np

from calibration.gel.look import GelLook
from drivers.errors import InputError, plural
from drivers.formats import check_zip, reason
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.training_frames import TrainingFrame, training_frames
from rig.labels.datasets import LabelledFile, read_dataset
from rig.labels.polygons import contact_label
from rig.sessions.files import REFERENCES
from rig.tactile.contact.background import MAX_FRAMES, MIN_FRAMES, auto_background

ARRAYS = ("frames", "backgrounds", "labels")
"""Fields of `Examples` with an entry per frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """Frames of one size with their backgrounds and labels.

    frames, backgrounds: (N, h, w, 3) uint8 RGB. labels: (N, h, w) uint8, 255 times the share of each pixel
    that lies inside the contact. objects: the object's id of each frame. simulated: whether any was rendered.
    """

    frames: Image
    backgrounds: Image
    labels: Image
    objects: tuple[str, ...]
    simulated: bool

    def __len__(self) -> int:
        return len(self.objects)

    def of(self, objects: Sequence[str]) -> "Examples":
        return self.at(np.flatnonzero(np.isin(self.objects, list(objects))))

    def at(self, places: Sequence[int] | np.ndarray) -> "Examples":
        chosen = np.asarray(places, np.int64)
        arrays = (getattr(self, name)[chosen] for name in ARRAYS)
        objects = tuple(self.objects[i] for i in chosen)
        return Examples(*arrays, objects=objects, simulated=self.simulated)


Row = tuple[Image, Image, Image, str]
"""Frame, background and label of one size, and the object's id."""


def resize(image: Image, size: tuple[int, int]) -> Image:
    """Return a frame or label at (width, height) `size` in px, by area."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def concatenate(parts: Sequence[Examples]) -> Examples:
    """Return several sets as one. Raises `InputError` if all are empty."""
    parts = [part for part in parts if len(part)]
    if not parts:
        raise InputError("no labelled frame: check the data folder")
    arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS)
    objects = tuple(name for part in parts for name in part.objects)
    return Examples(*arrays, objects=objects, simulated=any(part.simulated for part in parts))


def save_examples(path: Path, examples: Examples) -> None:
    """Store a set on disk, so that a resumed training need not create it again."""
    aside = path.with_name(path.name + ".part")
    with aside.open("wb") as stream:
        np.savez(stream, **{field.name: getattr(examples, field.name) for field in fields(examples)})
    aside.replace(path)


def load_examples(path: Path) -> Examples:
    """Read a stored set. Raises `InputError` for a damaged file."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_zip(str(path), archive)
        with np.load(path) as kept:
            arrays = (kept[name] for name in ARRAYS)
            objects = tuple(map(str, kept["objects"]))
            return Examples(*arrays, objects=objects, simulated=bool(kept["simulated"]))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"{path}: kept training frames are damaged ({reason(error)}): remove the file"
        ) from error


def folder_examples(
    folder: Path,
    size: tuple[int, int],
    progress: Callable[[int, int], None] = lambda done, total: None,
    named: Sequence[str] = (),
) -> Examples:
    """Read all labelled images under a folder at (width, height) `size`. Raises `InputError`.

    If the data has no frame without contact, one is estimated from the frames of each group. named: objects
    or folders of a fold of one's own; frames in such a folder count as an object of its name.
    """
    files = read_dataset(folder)
    made: dict[str, Image] = {}
    rows: list[Row] = []
    for file in files:
        image = read_image(file.image)
        frame, label = resize(image, size), resize(file.label(image.shape[:2]), size)
        if file.group not in made:
            made[file.group] = _background(file, files, size)
        inside = file.image.relative_to(folder).parts[:-1]
        object_id = next((name for name in named if name in inside), file.object_id)
        rows.append((frame, made[file.group], label, object_id))
        progress(len(rows), len(files))
    return _stack(rows, any(file.simulated for file in files))


def _stack(rows: Sequence[Row], simulated: bool) -> Examples:
    frames, backgrounds, labels, objects = zip(*rows, strict=True)
    return Examples(np.stack(frames), np.stack(backgrounds), np.stack(labels), objects, simulated)


def _background(file: LabelledFile, files: list[LabelledFile], size: tuple[int, int]) -> Image:
    if file.background is not None:
        return resize(read_image(file.background), size)
    group = [other.image for other in files if other.group == file.group]
    if len(group) < MIN_FRAMES:
        raise InputError(
            f"{file.group}: {plural(len(group), 'image')} cannot make a frame without contact: put one in "
            f"{Path(file.group) / REFERENCES}"
        )
    spread = np.unique(np.linspace(0, len(group) - 1, MAX_FRAMES).round().astype(int))
    return auto_background([resize(read_image(group[i]), size) for i in spread])


def simulated_examples(
    objects: Sequence[str],
    count: int,
    seed: int,
    size: tuple[int, int],
    random_share: float = 0.0,
    family: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    look: GelLook | None = None,
) -> Examples:
    """Render labelled frames (see `fakes.studio.training_frames`).

    size: (width, height) of the returned frames in px. The same seed gives the same frames.
    """
    return examples_of(training_frames(objects, seed, random_share, family, look), count, size, progress)


def examples_of(
    units: Iterable[Sequence[TrainingFrame]],
    count: int,
    size: tuple[int, int],
    progress: Callable[[int], None] = lambda done: None,
) -> Examples:
    """Return the first `count` frames of some sensor units at (width, height) `size`."""
    rows: list[Row] = []
    for unit in units:
        for shown in unit:
            no_contact = np.zeros(shown.image.shape[:2], np.uint8)
            label = no_contact if shown.touching is None else contact_label(shown.touching)
            frame, background, label = (resize(i, size) for i in (shown.image, shown.background, label))
            rows.append((frame, background, label, shown.object_id))
        progress(min(len(rows), count))
        if len(rows) >= count:
            break
    return _stack(rows[:count], True)
