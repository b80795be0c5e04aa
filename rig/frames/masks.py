"""Contact masks of images: reads files or folders and computes one mask per image, at the image's size."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from drivers.errors import InputError, no_such, plural
from drivers.images import SUFFIXES, images_in_order, load_image, read_image, require_single
from drivers.types import Image
from rig.frames.series import ENOUGH_FRAMES, FrameSeries, TimedFrame, make_background
from rig.frames.times import FrameTime
from rig.sessions.manifest import RecordManifest, is_session, read_manifest_of
from rig.sessions.rows import read_poses
from rig.tactile.contact.finder import NO_CONTACT, ContactFinder
from rig.tactile.contact.model_files import MODELS
from rig.tactile.contact.network import SHIPPED, NetworkInput, load_network
from rig.tactile.contact.segmenter import (
    FrameState,
    Segmentation,
    Segmenter,
    check_margin,
    contact_of,
    frame_exposure,
    moved_outline,
)

CLASSICAL = "classical"
DEFAULT_MODEL = "ours"
UNREADABLE = "unreadable"


@dataclass(frozen=True, slots=True)
class SegmentChoice:
    """Method and settings of contact segmentation.

    model: `classical`, a shipped network's name or an ONNX file. margin, alone: as in `Segmenter`.
    """

    model: str = DEFAULT_MODEL
    margin: float = 0.0
    threads: int = 1
    alone: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ImageGroup:
    """Images of one sensor. background: its frame without contact, None if not needed."""

    files: tuple[Path, ...]
    background: Image | None
    note: str


@dataclass(frozen=True, slots=True, eq=False)
class SegmentedImage:
    """Result for one file. image, segmentation: None if it could not be read."""

    file: Path
    image: Image | None
    segmentation: Segmentation | None
    cost_s: float

    @property
    def state(self) -> str:
        return UNREADABLE if self.segmentation is None else self.segmentation.state.value

    @property
    def mask(self) -> Image:
        """(H, W) uint8, 0 or 255; all 0 without contact, of shape (0, 0) if the file is unreadable."""
        if self.segmentation is not None and self.segmentation.contact.mask is not None:
            return self.segmentation.contact.mask
        return np.zeros((0, 0) if self.image is None else self.image.shape[:2], np.uint8)

    def as_json(self, mask: Path | None) -> dict[str, Any]:
        """Return the values for JSON output. mask: file of the mask, None without one."""
        return {
            "image": str(self.file),
            "mask": None if mask is None else str(mask),
            "state": self.state,
            "area_px": 0.0 if self.segmentation is None else self.segmentation.contact.area_px,
            "ms": round(1e3 * self.cost_s, 3),
        }


class ClassicalSegmenter:
    """Contact masks by classical image processing, with the interface of a network's segmenter."""

    def __init__(self, background: Image | None, margin: float) -> None:
        if background is None:
            raise InputError("the classical mask needs a frame without contact: give --background")
        self._background, self._margin = background, check_margin(margin)

    def segment(self, image: Image) -> Segmentation:
        """Return the contact and the frame's state, independent of other images."""
        # the contact finder has hysteresis; a new one does not depend on the image before
        contact = ContactFinder(self._background).find(image)
        state = frame_exposure(image)
        if state is not None:
            return Segmentation(NO_CONTACT, state)
        if contact.mask is None:
            return Segmentation(NO_CONTACT, FrameState.NO_CONTACT)
        return Segmentation(contact_of(moved_outline(contact.mask, self._margin)), FrameState.CONTACT)


FrameSegmenter = Segmenter | ClassicalSegmenter
MakeSegmenter = Callable[[Image | None], FrameSegmenter]
"""Makes the segmenter of a sensor from its background. Raises `InputError`."""


def segmenter_maker(choice: SegmentChoice) -> MakeSegmenter:
    """Return a factory of segmenters; a network is loaded only once. Raises `InputError`."""
    if choice.model == CLASSICAL:
        return lambda background: ClassicalSegmenter(background, choice.margin)
    network = load_network(choice.model, choice.threads)
    return lambda background: Segmenter(network, background, choice.margin, choice.alone)


def make_segmenter(choice: SegmentChoice, background: Image | None) -> FrameSegmenter:
    return segmenter_maker(choice)(background)


def needs_background(choice: SegmentChoice) -> bool:
    """Whether the chosen method needs a frame without contact. Raises `InputError`."""
    if choice.model == CLASSICAL:
        return True
    return load_network(choice.model).recipe.inputs is NetworkInput.FRAME_AND_DIFFERENCE


def image_groups(paths: Sequence[Path], background: str | None, compare: bool) -> list[ImageGroup]:
    """Return the images of files, folders and sessions of `rig record`, by sensor.

    background: see `rig.frames.series.make_background`; by default the session's own. compare: whether a
    background is needed. Raises `InputError`.
    """
    groups, files = [], []
    for path in paths:
        if is_session(path):
            groups += _session_groups(path, background, compare)
        else:
            files += _files(path)
    for file in files:
        require_single(file)
    if files:
        groups.append(_group(files, background, compare))
    return groups


def segment_groups(groups: Sequence[ImageGroup], choice: SegmentChoice) -> Iterator[SegmentedImage]:
    """Segment the images in order; a file that cannot be read yields empty fields. Raises `InputError`."""
    make = segmenter_maker(choice)
    for group in groups:
        segmenter = make(group.background)
        for file in group.files:
            image = load_image(file)
            began = perf_counter()
            try:
                found = None if image is None else segmenter.segment(image)
            except InputError as error:
                raise InputError(f"{file}: {error}") from error
            yield SegmentedImage(file, image, found, perf_counter() - began)


def mask_figures(rows: Sequence[Mapping[str, Any]]) -> tuple[dict[str, int], float | None]:
    """Return the number of images by state, and the median time per image that could be read, ms.

    rows: as `SegmentedImage.as_json` returns them.
    """
    states = dict(sorted(Counter(row["state"] for row in rows).items()))
    costs = [row["ms"] for row in rows if row["state"] != UNREADABLE]
    return states, round(median(costs), 3) if costs else None


def output_names(groups: Sequence[ImageGroup], out: Path, ending: str) -> dict[Path, Path]:
    """Return the file in `out` for each image, by its stem.

    Raises `InputError` if two images have the same stem, or a file would replace an image.
    """
    names: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    for file in (file for group in groups for file in group.files):
        name = out / f"{file.stem}{ending}"
        if name in taken:
            raise InputError(f"{file} and {taken[name]} would both become {name}: segment them apart")
        if name.resolve() == file.resolve():
            raise InputError(f"{name} would replace the image itself: choose another --out")
        names[file], taken[name] = name, file
    return names


def make_folder(out: Path) -> None:
    """Make the folder for results. Raises `InputError` if that fails."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}): choose another --out") from error


def _session_groups(session: Path, background: str | None, compare: bool) -> list[ImageGroup]:
    read_manifest_of(session, RecordManifest, "give one of rig record, or a folder of images")
    taken: dict[str, list[Path]] = {}
    for pose in read_poses(session):
        for image in pose.images if pose.accepted else ():
            taken.setdefault(image.serial, []).append(session / image.file)
    if not taken:
        raise InputError(f"{session}: no images yet; continue the recording with --resume")
    groups = []
    for serial, files in sorted(taken.items()):
        if background is not None or not compare:
            groups.append(_group(files, background, compare))
        else:
            own = read_image(session / "reference" / f"{serial}.png")
            groups.append(ImageGroup(tuple(files), own, f"background of {serial}: the session's own"))
    return groups


def _group(files: list[Path], background: str | None, compare: bool) -> ImageGroup:
    if not compare:
        return ImageGroup(tuple(files), None, "background: none needed")

    def read() -> Iterator[TimedFrame]:
        return (TimedFrame(file.name, FrameTime("0", 0), load_image(file)) for file in files)

    series = FrameSeries(str(files[0].parent), read)
    if background is None and len(files) < ENOUGH_FRAMES:
        raise InputError(
            f"{series.name}: {plural(len(files), 'image')} cannot make a background: give --background IMAGE"
        )
    # `auto`, because the order of images in a data set has no meaning, unlike in a recording
    return ImageGroup(tuple(files), *make_background(background or "auto", series))


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(no_such(path))
    if path.is_file():
        return [path]
    files = images_in_order(path.iterdir())
    if not files:
        raise InputError(f"{path}: no images in it ({', '.join(SUFFIXES)}): check the path")
    return files


def shipped_cards() -> list[dict[str, Any]]:
    """Return the model cards of the shipped networks, as `rig train` writes them.

    The added key `shipped` contains name, size, hash and precision of the shipped file. Raises `InputError`
    if the hash of a file is not in its card.
    """
    cards = []
    for name in SHIPPED:
        card = json.loads((MODELS / f"{name}.json").read_text(encoding="utf-8"))
        digest = sha256((MODELS / f"{name}.onnx").read_bytes()).hexdigest()
        precision = next((p for p, facts in card["files"].items() if facts["sha256"] == digest), None)
        if precision is None:
            raise InputError(
                f"the shipped network '{name}' does not match its model card: install the rig again"
            )
        shipped = {**card["files"][precision], "file": f"{name}.onnx", "precision": precision}
        cards.append({**card, "name": name, "shipped": shipped})
    return cards
