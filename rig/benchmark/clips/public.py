"""Public data sets with labels in this package: frames are made from a clone that the user has."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from drivers.errors import FormatError, InputError, unknown_name
from drivers.formats import read_csv_rows
from drivers.images import decode_image, encode_png
from drivers.types import Image
from rig.frames.clips import BACKGROUND, FRAMES, LABELS, TIMES
from rig.frames.estimates import table
from rig.frames.series import read_frames
from rig.sessions.files import cache_folder

PACKAGED = Path(__file__).parent / "sets"


@dataclass(frozen=True, slots=True)
class PublicSet:
    """A data set whose labels are in this package, and whose frames are in a public repository."""

    name: str
    data: str  # the sensor and what was recorded, for a reader of the README
    repository: str  # owner and name on GitHub
    commit: str
    licence: str  # of the frames; the labels have that of this package
    folder: Path = PACKAGED  # of the labels and sources

    @property
    def labels(self) -> Path:
        return self.folder / f"{self.name}.csv"

    @property
    def sources(self) -> Path:
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
            "a real DIGIT, straight edges turned by hand (four of five clips: one frame per second)",
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


def find_set(name: str) -> PublicSet:
    if name not in SETS:
        raise unknown_name("set", name, SETS)
    return SETS[name]


def make_clips(of: PublicSet, clone: Path) -> Path:
    """Return the folder of a set's clips, for `read_clips`; make it in the cache if it is not there.

    clone: work tree or git directory of the set's repository; its files are compared with the stored hashes
    in each call. Raises `InputError` for another folder, commit or file, or if the cache cannot be written.
    """
    columns = ("clip", "use", "path", "frame", "t_s", "sha256")
    sources = [row for _, row in read_csv_rows(of.sources, columns)]
    files = read_verified(clone, of, {row["path"]: row["sha256"] for row in sources if row["path"]})
    # A version with other labels or files makes another folder.
    version = hashlib.sha256(of.labels.read_bytes() + of.sources.read_bytes()).hexdigest()[:8]
    folder = cache_folder() / "clips" / f"{of.name}-{version}"
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{of.name}-") as place:
            made = Path(place) / "made"
            labels: list[dict[str, object]] = [{**row} for _, row in read_csv_rows(of.labels, ("clip",))]
            for name in dict.fromkeys(row["clip"] for row in sources):
                clip = made / name
                clip.mkdir(parents=True)
                (clip / LABELS).write_text(table([row for row in labels if row["clip"] == name]), "utf-8")
                _write_frames(clip, [row for row in sources if row["clip"] == name], files)
            made.rename(folder)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}): set XDG_CACHE_HOME to a writable folder"
        ) from error
    return folder


def _write_frames(clip: Path, sources: Sequence[Mapping[str, str]], files: Mapping[str, bytes]) -> None:
    parts = [_image(row, files[row["path"]]) for row in sources if row["use"] == "background"]
    background = np.rint(np.median(parts, axis=0)).astype(np.uint8)
    (clip / f"{BACKGROUND}.png").write_bytes(encode_png(background))
    for row in sources:
        if row["use"] == "video":
            (clip / f"clip{Path(row['path']).suffix}").write_bytes(files[row["path"]])
    frames = [row for row in sources if row["use"] == "frame"]
    if frames:
        (clip / FRAMES).mkdir()
        times: list[dict[str, object]] = [
            {"frame": number, "t_s": row["t_s"]} for number, row in enumerate(frames)
        ]
        (clip / TIMES).write_text(table(times), "utf-8")
    for number, row in enumerate(frames):
        image = _image(row, files[row["path"]]) if row["path"] else background
        (clip / FRAMES / f"{number:06d}.png").write_bytes(encode_png(image))


def _image(source: Mapping[str, str], data: bytes) -> Image:
    """Decode an image, or a frame of a video. Raises `FormatError`."""
    image = decode_image(data)
    if image is None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"video{Path(source['path']).suffix}"
            file.write_bytes(data)
            image = next(islice(read_frames(file).images(), int(source["frame"] or 0), None), None)
    if image is None:
        raise FormatError(
            f"{source['path']}: cannot be decoded: install the version of OpenCV that pip selects"
        )
    return image


def read_verified(clone: Path, of: PublicSet, sha256: Mapping[str, str]) -> dict[str, bytes]:
    """Return the contents of files at the set's commit by path, each compared with its stored hash.

    clone: work tree or git directory. sha256: by path. Raises `InputError` without git, for another folder, a
    missing commit, a missing file, or a file that differs from its hash.
    """
    address, short = f"https://github.com/{of.repository}", of.commit[:8]
    wanted = f"give a clone: git clone {address}"
    if not clone.is_dir():
        raise InputError(f"{clone}: there is no such folder: {wanted}")
    try:
        _git(clone, "rev-parse", "--git-dir")
    except InputError as error:
        raise InputError(f"{error}; {wanted}") from error
    try:
        _git(clone, "cat-file", "-e", f"{of.commit}^{{commit}}")
    except InputError as error:
        raise InputError(
            f"{clone}: has no commit {short} of {of.repository}: if it is a shallow clone of it, run git "
            f"-C {clone} fetch --unshallow, if an older one, git -C {clone} fetch; otherwise {wanted}"
        ) from error
    files = {}
    for path, expected in sha256.items():
        files[path] = _git(clone, "cat-file", "blob", f"{of.commit}:{path}")
        found = hashlib.sha256(files[path]).hexdigest()
        if found != expected:
            raise InputError(
                f"{clone}: {path} at {short} has the SHA-256 {found[:12]}..., the labelled file had "
                f"{expected[:12]}...: clone {address} again"
            )
    return files


def _git(clone: Path, *arguments: str) -> bytes:
    """Return the output of a git command. Raises `InputError` with git's reason."""
    program = shutil.which("git")
    if program is None:
        raise InputError("git was not found on this computer: install it, for example with apt install git")
    # Variables such as GIT_DIR would select another repository than the folder that was given.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    command = [program, "-C", str(clone), *arguments]
    done = subprocess.run(command, capture_output=True, check=False, env=environment)  # noqa: S603 - git
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().removeprefix("fatal: ")
        raise InputError(f"{clone}: git cannot read it ({reason})")
    return done.stdout
