"""Readers of labelled images: the paper's data set, LabelMe files, and sessions of `rig record`.

VISTASE has a folder per object with `image_label` (images and LabelMe JSON side by side) and
`voc_format` (`JPEGImages`, `SegmentationClassPNG`). A session keeps the true masks of simulated
images under `truth/masks`, and its sensors' frames without contact under `reference`.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import InputError, no_such, unknown_name
from drivers.formats import MOST_JSON_BYTES, quote, read_bounded
from drivers.images import SUFFIXES, read_image, require_same_aspect
from drivers.types import Image
from protocols.grasps import find_grasp_file
from rig.labels.label_files import labelme_mask, read_label
from rig.labels.polygons import contact_label
from rig.sessions.files import MANIFEST, REFERENCES, TRUE_MASKS, reference_file, true_mask_file
from rig.sessions.manifest import RecordManifest, read_manifest
from rig.sessions.rows import read_poses

_VOC = "voc_format"
_LONGEST_NAME = 200
_NUMBER = re.compile(r"(?<![0-9])0*([0-9]{1,3})(?![0-9])")


@dataclass(frozen=True, slots=True)
class Fold:
    """Ids of the objects to train on, to validate on (choice of the best epoch) and to test on.

    A fold of one's own trains on all other objects, so `train` is empty; in it folders may stand for objects.
    """

    name: str
    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


_PARTS = {
    "D_s1": ("1 2 4 5 6 8 10 12 13 14 15", "7 9 11", "3 16"),
    "D_s2": ("1 2 3 4 6 7 10 11 12 13 16", "5 9 14", "8 15"),
    "D_s3": ("1 3 5 6 7 8 9 10 11 13 14", "4 15 16", "2 12"),
}
"""Castano-Amoros and Gil 2023, Table I."""
FOLDS = {name: Fold(name, *(tuple(ids.split()) for ids in parts)) for name, parts in _PARTS.items()}


OWN_FOLD = "own"


def find_fold(name: str) -> Fold:
    """Return a fold by its name, ignoring case. Raises `InputError`."""
    found = next((fold for known, fold in FOLDS.items() if known.lower() == name.lower()), None)
    if found is None:
        raise unknown_name("fold", name, FOLDS)
    return found


def own_fold(validation: Sequence[str], test: Sequence[str]) -> Fold:
    """Return a fold of one's own data, tested on the objects to validate on if no others are given."""
    return Fold(OWN_FOLD, (), tuple(validation), tuple(test or validation))


def check_objects(fold: Fold, present: Sequence[str], where: str) -> None:
    """Raise `InputError` unless training, validation and test objects are among those present."""
    found = set(present)
    others = found - set(fold.validation) - set(fold.test)
    for part, wanted in (("train", fold.train), ("validate", fold.validation), ("test", fold.test)):
        if not (set(wanted) & found if wanted else others):
            needs = f"one of {', '.join(wanted)}" if wanted else "one that is neither validated nor tested on"
            raise InputError(
                f"{where}: no object to {part} with in fold {fold.name} (needs {needs}; "
                f"found {', '.join(sorted(found)) or 'none'}): choose with --validate OBJECT or --validate "
                "FOLDER, or another --fold"
            )


ReadLabel = Callable[[tuple[int, int]], Image]
"""Returns the label of an image of (H, W) as (H, W) uint8, 0 or 255. Raises `InputError`."""


@dataclass(frozen=True, slots=True)
class LabelledFile:
    """One labelled image on disk.

    background: file with the same sensor's frame without contact, None if the data has none. group: name
    shared by the images of one sensor and object, from which a background can be made. simulated: whether the
    image was rendered.
    """

    image: Path
    object_id: str
    group: str
    background: Path | None
    simulated: bool
    label: ReadLabel


def read_dataset(folder: Path) -> list[LabelledFile]:
    """Find all labelled images under a folder, in any of the three layouts, sorted by object and name.

    Raises `InputError` if there is none.
    """
    if not folder.is_dir():
        raise InputError(no_such(folder, "folder", "give the one that holds the objects' folders"))
    sessions = sorted(path.parent for path in folder.rglob(MANIFEST))
    found = [file for session in sessions for file in _session_files(session)]
    inside_sessions = [session.resolve() for session in sessions]
    for place in [folder, *sorted(path for path in folder.rglob("*") if path.is_dir())]:
        if not any(place.resolve().is_relative_to(session) for session in inside_sessions):
            found += _voc_files(place) if place.name == _VOC else _labelme_files(place)
    if not found:
        raise InputError(
            f"{folder}: no labelled image in it: give a VISTASE folder (voc_format or image_label per "
            "object), a folder of LabelMe files, or simulated sessions of rig record"
        )
    kept: dict[tuple[str, str, str], LabelledFile] = {}
    for file in found:  # VISTASE contains every image twice, as LabelMe and VOC; the first one is kept
        kept.setdefault((str(_object_folder(file.image.parent)), file.object_id, file.image.stem), file)
    return sorted(kept.values(), key=lambda file: (file.object_id, file.group, file.image.name))


def object_of(folder: Path) -> str:
    """Return the object's id from a folder's name: its number, a known object's name, or the name itself."""
    number = _NUMBER.search(folder.name)
    if number:
        return number.group(1)
    try:
        return find_grasp_file(folder.name.replace("_", " ")).id
    except InputError:
        return folder.name


def _object_folder(place: Path) -> Path:
    """Return the parent of a folder such as `image_label` or `voc_format`; else the folder itself."""
    while place.name in ("image_label", _VOC, "JPEGImages", "SegmentationClassPNG"):
        place = place.parent
    return place


def _voc_files(folder: Path) -> list[LabelledFile]:
    owner = _object_folder(folder)
    files = []
    for label in sorted((folder / "SegmentationClassPNG").glob("*.png")):
        image = _beside(folder / "JPEGImages" / label.stem)
        if image is None:
            raise InputError(f"{label}: no image of that name in {folder / 'JPEGImages'}: copy it again")
        files.append(_file(image, owner, partial(_png_label, label)))
    return files


def _labelme_files(folder: Path) -> list[LabelledFile]:
    owner = _object_folder(folder)
    files = []
    for path in sorted(folder.glob("*.json")):
        if b'"shapes"' not in read_bounded(path, MOST_JSON_BYTES):  # for example a manifest or a COCO file
            continue
        document, image = read_label(path), _beside(path.with_suffix(""))
        if image is None:
            named = str(document.get("imagePath", "")).replace("\\", "/")
            image = path.parent / named
            if len(named) > _LONGEST_NAME or "\0" in named or not image.is_file():
                raise InputError(f"{path}: its image {quote(named)} is not beside it: copy it there")
        files.append(_file(image, owner, partial(labelme_mask, document, where=str(path))))
    return files


def _session_files(session: Path) -> list[LabelledFile]:
    manifest = read_manifest(session)
    if not isinstance(manifest, RecordManifest) or not (session / TRUE_MASKS).is_dir():
        return []
    files = []
    for pose in read_poses(session):
        for taken in pose.images if pose.accepted else ():
            image, group = session / taken.file, f"{session}/{taken.serial}"
            background = session / reference_file(taken.serial)
            label = partial(_session_label, session / true_mask_file(image.stem))
            files.append(LabelledFile(image, manifest.objects[0], group, background, True, label))
    return files


def _session_label(path: Path, shape: tuple[int, int]) -> Image:
    return contact_label(_png_label(path, shape))


def _file(image: Path, owner: Path, read_label: ReadLabel) -> LabelledFile:
    background = min((owner / REFERENCES).glob("*.png"), default=None)
    return LabelledFile(image, object_of(owner), str(owner), background, False, read_label)


def _beside(stem: Path) -> Path | None:
    """Return the image file with this stem; None if there is none."""
    names = (stem.name + e for ending in SUFFIXES for e in (ending, ending.upper()))
    return next((path for path in map(stem.with_name, names) if path.is_file()), None)


def _png_label(path: Path, shape: tuple[int, int]) -> Image:
    """Read a mask or a VOC class image: every pixel that is not black is contact."""
    image = read_image(path).max(axis=2)
    require_same_aspect(str(path), (image.shape[1], image.shape[0]), shape)
    if image.shape != shape:
        image = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return np.where(image > 0, 255, 0).astype(np.uint8)
