"""Public data sets with labels in this package: frames are made from a clone that the user has."""

import csv
import hashlib
import io
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from drivers.errors import FormatError, InputError, unknown_name
from drivers.formats import read_csv_rows
from drivers.images import decode_image, encode_png
from drivers.types import Image
from rig.benchmark.clips.clone import read_verified
from rig.frames.clips import BACKGROUND, FRAMES, LABELS, TIMES
from rig.frames.series import read_frames
from rig.sessions.files import cache_folder

PACKAGED = Path(__file__).parent / "sets"


@dataclass(frozen=True, slots=True)
class PublicSet:
    """A data set whose labels are in this package, and whose frames are in a public repository.

    data: the sensor and what was recorded, for a reader of the README. repository: owner and name on GitHub.
    licence: of the frames; the labels have that of this package. folder: of the labels and sources.
    """

    name: str
    data: str
    repository: str
    commit: str
    licence: str
    folder: Path = PACKAGED

    @property
    def labels(self) -> Path:
        """File with the labels."""
        return self.folder / f"{self.name}.csv"

    @property
    def sources(self) -> Path:
        """File with the paths and hashes of the labelled files."""
        return self.folder / f"{self.name}_sources.csv"


SETS = {
    of.name: of
    for of in (
        PublicSet(
            "octopi",
            "a real GelSight Mini (another tactile camera), objects turned by hand",
            "clear-nus/octopi",
            "b7f0b0b56a5be950a10c46aa40277dfd51050eab",
            "none stated: evaluate privately, do not distribute",
        ),
        PublicSet(
            "digit-edges",
            "a real DIGIT, straight edges turned by hand; 4 of 5 clips have one picture a second",
            "pyonkti/digit",
            "df0f4d6aa5b7bf23dbff10152300bd2e8d5182c9",
            "CC BY-NC 4.0",
        ),
        PublicSet(
            "gripper-slips",
            "a real GelSight Mini with printed dots, objects that slip in a gripper",
            "amitparag/Incipient-Slip-Detection",
            "20a79458aa204c2c49bfaa0ef721c5541c6fad0a",
            "BSD 2-Clause",
        ),
    )
}
"""Sets by name."""


@dataclass(frozen=True, slots=True)
class Source:
    """A file of a clip, a row of the table of sources. frame: of a video, used as background."""

    clip: str
    use: str
    path: str
    frame: int
    t_s: str
    sha256: str


def find_set(name: str) -> PublicSet:
    """Return a set by name. Raises `InputError`."""
    if name not in SETS:
        raise unknown_name("set", name, SETS)
    return SETS[name]


def make_clips(of: PublicSet, clone: Path) -> Path:
    """Return the folder of a set's clips, for `read_clips`; make it in the cache if it is not there.

    clone: work tree or git directory of the set's repository; its files are compared with the stored hashes
    in each call. Raises `InputError` for another folder, commit or file, or if the cache cannot be written.
    """
    sources = _read_sources(of.sources)
    files = read_verified(
        clone, of.repository, of.commit, {row.path: row.sha256 for row in sources if row.path}
    )
    # A version with other labels or files makes another folder.
    version = hashlib.sha256(of.labels.read_bytes() + of.sources.read_bytes()).hexdigest()[:8]
    folder = cache_folder() / "clips" / f"{of.name}-{version}"
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{of.name}-") as place:
            made = Path(place) / "made"
            _write_clips(made, of, sources, files)
            made.rename(folder)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}): set XDG_CACHE_HOME to a writable folder"
        ) from error
    return folder


def _read_sources(table: Path) -> list[Source]:
    rows = [row for _, row in read_csv_rows(table, ("clip", "use", "path", "frame", "t_s", "sha256"))]
    return [
        Source(row["clip"], row["use"], row["path"], int(row["frame"] or 0), row["t_s"], row["sha256"])
        for row in rows
    ]


def _write_clips(folder: Path, of: PublicSet, sources: Sequence[Source], files: Mapping[str, bytes]) -> None:
    labels = [row for _, row in read_csv_rows(of.labels, ("clip",))]
    for name in dict.fromkeys(row.clip for row in sources):
        clip = folder / name
        clip.mkdir(parents=True)
        (clip / LABELS).write_text(_csv([row for row in labels if row["clip"] == name]), encoding="utf-8")
        _write_frames(clip, [row for row in sources if row.clip == name], files)


def _write_frames(clip: Path, sources: Sequence[Source], files: Mapping[str, bytes]) -> None:
    """Write background, and the video or the frames with their times."""
    parts = [_image(row, files[row.path]) for row in sources if row.use == "background"]
    background = np.rint(np.median(parts, axis=0)).astype(np.uint8)
    (clip / f"{BACKGROUND}.png").write_bytes(encode_png(background))
    for row in sources:
        if row.use == "video":
            (clip / f"clip{Path(row.path).suffix}").write_bytes(files[row.path])
    frames = [row for row in sources if row.use == "frame"]
    if frames:
        (clip / FRAMES).mkdir()
        times = [{"frame": str(number), "t_s": row.t_s} for number, row in enumerate(frames)]
        (clip / TIMES).write_text(_csv(times), encoding="utf-8")
    for number, row in enumerate(frames):
        image = _image(row, files[row.path]) if row.path else background
        (clip / FRAMES / f"{number:06d}.png").write_bytes(encode_png(image))


def _image(source: Source, data: bytes) -> Image:
    """Decode an image, or a frame of a video. Raises `FormatError`."""
    image = decode_image(data)
    if image is None:
        image = next(islice(_video(data, Path(source.path).suffix), source.frame, None), None)
    if image is None:
        raise FormatError(f"{source.path}: cannot be decoded: install the version of OpenCV that pip selects")
    return image


def _video(data: bytes, suffix: str) -> Iterator[Image]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"video{suffix}"
        file.write_bytes(data)
        yield from read_frames(file).images()


def _csv(rows: Sequence[Mapping[str, str]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
