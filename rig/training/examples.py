"""Labelled frames in memory."""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import InputError
from drivers.formats import reason
from drivers.types import Image


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """Frames of one size with what belongs to them.

    frames, backgrounds: (N, h, w, 3) uint8 RGB. labels: (N, h, w) uint8, share of each pixel inside
    the contact times 255. objects: the object's id of each frame. simulated: whether any was rendered.
    """

    frames: Image
    backgrounds: Image
    labels: Image
    objects: tuple[str, ...]
    simulated: bool

    def __len__(self) -> int:
        return len(self.objects)

    def of(self, objects: Sequence[str]) -> "Examples":
        """Return the frames of some objects."""
        return self.at(np.flatnonzero(np.isin(self.objects, list(objects))))

    def at(self, places: Sequence[int] | np.ndarray) -> "Examples":
        """Return the frames at some places."""
        chosen = np.asarray(places, np.int64)
        return Examples(
            self.frames[chosen],
            self.backgrounds[chosen],
            self.labels[chosen],
            tuple(self.objects[i] for i in chosen),
            self.simulated,
        )


def sized(image: Image, size: tuple[int, int]) -> Image:
    """Return a frame or label at (width, height) `size` in px, by area."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def joined(parts: Sequence[Examples]) -> Examples:
    """Return several sets as one. Raises `InputError` where there is none."""
    parts = [part for part in parts if len(part)]
    if not parts:
        raise InputError("no labelled frame: check the data folder")
    return Examples(
        np.concatenate([part.frames for part in parts]),
        np.concatenate([part.backgrounds for part in parts]),
        np.concatenate([part.labels for part in parts]),
        tuple(name for part in parts for name in part.objects),
        any(part.simulated for part in parts),
    )


def save_examples(path: Path, examples: Examples) -> None:
    """Keep a set on disk, so that a continued training does not make it again."""
    aside = path.with_name(path.name + ".part")
    with aside.open("wb") as stream:
        np.savez(
            stream,
            frames=examples.frames,
            backgrounds=examples.backgrounds,
            labels=examples.labels,
            objects=np.array(examples.objects),
            simulated=examples.simulated,
        )
    aside.replace(path)


def load_examples(path: Path) -> Examples:
    """Read a kept set. Raises `InputError` for a damaged file."""
    try:
        with np.load(path) as kept:
            return Examples(
                kept["frames"],
                kept["backgrounds"],
                kept["labels"],
                tuple(map(str, kept["objects"])),
                bool(kept["simulated"]),
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"{path}: kept training frames are damaged ({reason(error)}): remove the file"
        ) from error
