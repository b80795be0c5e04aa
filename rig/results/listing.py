"""List the sessions in a folder with their results and problems."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from statistics import median

from drivers.errors import InputError, SessionError, no_such
from drivers.images import image_flaw
from protocols.grasps import find_grasp_file
from protocols.reaction import ReactionKind
from rig.results.limits import apply_limits
from rig.results.metrics import Mare, mare_of
from rig.results.table import REPLAYS
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.files import MANIFEST, RECORDINGS, RESULTS
from rig.sessions.manifest import (
    AnyManifest,
    BenchManifest,
    RecordManifest,
    TrialManifest,
    read_manifest,
)
from rig.sessions.recording_file import check_recording
from rig.sessions.records import LIFTS, accepted_lifts
from rig.sessions.rows import read_poses, read_rows, read_timing, rows_and_problems
from rig.sessions.session import in_use


class SessionState(StrEnum):
    """Progress of a session."""

    COMPLETE = "complete"
    RUNNING = "running"
    UNFINISHED = "unfinished"
    THINNED = "without recordings"
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class SessionEntry:
    """One session: its manifest, None if it cannot be read, and its state on disk.

    problem: why the session is broken; None if it is not. done: number of accepted lifts of a trial, or poses
    of a recording. mare: over phases B and C, of the session's own estimator; None without any error.
    contact_area_px: median area of the contacts by serial, of lifts or images; empty for replays.
    limits_missed: number of figures that miss their limit; None without limits or without a lift.
    """

    folder: Path
    state: SessionState
    problem: str | None
    size_bytes: int
    manifest: AnyManifest | None
    done: int = 0
    mare: Mare | None = None
    contact_area_px: Mapping[str, float] = field(default_factory=dict)
    limits_missed: int | None = None

    @property
    def bench_manifest(self) -> TrialManifest | RecordManifest | None:
        """The manifest of a trial or recording; None for replays and unreadable manifests."""
        return self.manifest if isinstance(self.manifest, BenchManifest) else None

    @property
    def objects(self) -> tuple[str, ...]:
        return self.bench_manifest.objects if self.bench_manifest else ()

    @property
    def remarks(self) -> Remarks:
        return self.bench_manifest.remarks if self.bench_manifest else NO_REMARKS

    @property
    def started(self) -> str:
        return self.manifest.started if self.manifest else ""

    @property
    def object_names(self) -> set[str]:
        """Ids and names of the requested objects, in lower case."""
        own = self.bench_manifest.config.objects if self.bench_manifest else ()
        names = {object_id.lower() for object_id in self.objects}
        for object_id in self.objects:
            with suppress(InputError):  # an object of another version of the rig
                names.update(find_grasp_file(object_id, own).names)
        return names

    @property
    def wanted(self) -> int | None:
        return self.bench_manifest.wanted if self.bench_manifest else None

    @property
    def bench_text(self) -> str:
        """The bench for a table; empty for replays and unreadable manifests."""
        on = self.bench_manifest
        return "" if on is None else "SIMULATED" if on.simulated else on.bench

    @property
    def react(self) -> str:
        """The reaction to slip of a trial, as "tighten"; empty without one."""
        kind = self.manifest.react if isinstance(self.manifest, TrialManifest) else ReactionKind.NONE
        return "" if kind is ReactionKind.NONE else kind.value

    @property
    def estimator_text(self) -> str:
        """The estimator of a trial or replay with its window, for a table; empty for others."""
        name, window = getattr(self.manifest, "estimator", None), getattr(self.manifest, "window", None)
        return "" if name is None else name if window in (None, 1) else f"{name}, window {window}"

    @property
    def limits_text(self) -> str:
        """Whether the limits of the session are kept, for a table; empty without limits."""
        missed = self.limits_missed
        return "" if missed is None else f"{missed} missed" if missed else "kept"

    @property
    def objects_text(self) -> str:
        """The objects for a table; of more than three objects only the first two."""
        few, more = self.objects[:2], len(self.objects) - 2
        return f"{', '.join(few)} and {more} more" if more > 1 else ", ".join(self.objects)

    def as_json(self) -> dict[str, object]:
        manifest, on, mare = self.manifest, self.bench_manifest, self.mare
        return {
            "session": str(self.folder),
            "date": manifest.started if manifest else None,
            "kind": manifest.kind if manifest else None,
            "bench": on.bench if on else None,
            "simulated": on.simulated if on else None,
            "estimator": getattr(manifest, "estimator", None),
            "window": getattr(manifest, "window", None),
            "react": self.react or None,
            "objects": self.objects,
            **asdict(self.remarks),
            "done": self.done,
            "wanted": self.wanted,
            "mare_deg": mare and mare.mean_deg,
            "mare_interval_deg": mare and mare.ends_deg,
            "lifts_refused": mare and mare.refused,
            "limits_missed": self.limits_missed,
            "contact_area_px": dict(self.contact_area_px),
            "size_bytes": self.size_bytes,
            "state": self.state.value,
            "problem": self.problem,
        }


def find_sessions(folder: Path) -> list[Path]:
    """Return the session folders at or below a folder, sorted. Raises `InputError` if it does not exist.

    A folder with results or recordings but without a manifest is included, as a broken session.
    """
    if not folder.is_dir():
        raise InputError(no_such(folder, "folder", "give the one that holds the sessions"))
    found = []
    for place, names, files in os.walk(folder):
        if MANIFEST in files or set(RESULTS.values()) & set(files) or Path(place, RECORDINGS).is_dir():
            found.append(Path(place))
            names.clear()
        names.sort()
    return sorted(found)


def holds_sessions(folder: Path) -> bool:
    """Whether a folder is not a session itself but has sessions below it."""
    return folder.is_dir() and find_sessions(folder) not in ([], [folder])


def list_session(folder: Path, quick: bool = False) -> SessionEntry:
    """Check one session and the checksums of its recordings; problems are reported in the entry.

    quick: check only that the recordings and images exist.
    """
    sizes = _sizes(os.fspath(folder))
    size = sum(sizes.values())
    manifest: AnyManifest | None = None
    try:
        manifest = read_manifest(folder)
        return _entry(folder, sizes, manifest, quick)
    except InputError as error:
        return SessionEntry(folder, SessionState.BROKEN, str(error), size, manifest)


def list_sessions(folders: Sequence[Path], quick: bool) -> list[SessionEntry]:
    """Check several sessions one after the other; see `list_session`."""
    return [list_session(folder, quick) for folder in folders]


def _sizes(folder: str, inside: str = "") -> dict[str, int]:
    """Return the sizes in bytes of a session's files by relative path; there may be thousands of files."""
    found: dict[str, int] = {}
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                found |= _sizes(entry.path, f"{inside}{entry.name}/")
            elif entry.is_file():
                found[f"{inside}{entry.name}"] = entry.stat().st_size
    return found


def _entry(folder: Path, sizes: Mapping[str, int], manifest: AnyManifest, quick: bool) -> SessionEntry:
    done, mare, areas, files, what, thinned, missed = 0, None, [], [], "recording", False, None
    problems: list[str] = []
    if isinstance(manifest, TrialManifest):
        rows, problems = rows_and_problems(folder / RESULTS[manifest.kind], LIFTS)
        lifts = accepted_lifts(rows)
        done, mare = len(lifts), mare_of(lift.re for lift in lifts)
        if lifts and (limits := manifest.config.limits):
            missed = sum(not one.met for one in apply_limits(limits, rows, read_timing(folder)))
        areas = [area for lift in lifts for area in lift.contact_area_px.items()]
        # The folder of all recordings is deleted to free the disk; a single missing one is damage.
        thinned = manifest.status == "complete" and not (folder / RECORDINGS).is_dir()
        files = [] if thinned else [lift.recording for lift in lifts]
    elif isinstance(manifest, RecordManifest):
        poses = [pose for pose in read_poses(folder) if pose.accepted]
        images = [image for pose in poses for image in pose.images]
        done, what = len(poses), "image"
        areas = [(image.serial, image.contact_area_px) for image in images]
        files = [image.file for image in images]
    else:
        done = sum(row["accepted"] is True for row in read_rows(folder / RESULTS[manifest.kind], REPLAYS))
    damage = (_damage(folder / file, what, file in sizes, quick) for file in files)
    problems += filter(None, damage)
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    state = SessionState.COMPLETE if manifest.status == "complete" else SessionState.UNFINISHED
    if problems:
        state = SessionState.BROKEN
    elif in_use(folder):
        state = SessionState.RUNNING
    elif thinned:
        state = SessionState.THINNED
    problem = f"{problems[0]}{more}" if problems else None
    size = sum(sizes.values())
    by_serial = {of: median(area for serial, area in areas if serial == of) for of in sorted(dict(areas))}
    return SessionEntry(folder, state, problem, size, manifest, done, mare, by_serial, missed)


def _damage(path: Path, what: str, exists: bool, quick: bool) -> str | None:
    """Return the problem of a session's file, None without any. quick: check only that it exists."""
    if not exists:
        return f"{path}: the {what} is missing"
    if quick:
        return None
    if what == "image":
        flaw = image_flaw(path)
        return None if flaw is None else f"{path}: the image {flaw}"
    try:
        check_recording(path)
    except SessionError as error:
        return str(error)
    return None
