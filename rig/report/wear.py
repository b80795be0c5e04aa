"""Changes of the sensors over sessions: noise and image of the untouched gel, contact area, error."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError, SessionError, counted
from drivers.images import load_image
from protocols.observer import Phase
from rig.report.session import UNREADABLE
from rig.results.metrics import Mare, mare_of
from rig.sessions.files import reference_file
from rig.sessions.manifest import BenchManifest, RecordManifest, TrialManifest, read_manifest_of
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.records import FinishedLift
from rig.sessions.rows import read_poses, read_usable_lifts

MOST_FRAMES = 30
"""Number of frames of one sensor in one lift for its noise: half a second."""


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """A sensor without contact: its mean image, (H, W, 3) float32 grey levels, and its noise.

    noise: standard deviation over time, mean over the image, grey levels; None if there is only one image.
    """

    picture: NDArray[np.float32]
    noise: float | None


@dataclass(frozen=True, slots=True)
class TipWear:
    """One sensor in one session; None for values that the session does not contain.

    noise: see `Rest`. change: mean change of its image without contact since the sensor's first session, grey
    levels. contact_px: median area of the contacts.
    """

    noise: float | None
    change: float | None
    contact_px: float | None


@dataclass(frozen=True, slots=True)
class SessionWear:
    """One session, tips by serial. lifts, mare: of a trial; None and 0 otherwise."""

    folder: Path
    manifest: TrialManifest | RecordManifest
    began: datetime
    tips: dict[str, TipWear]
    lifts: int
    mare: Mare | None


def read_wear(folders: Sequence[Path]) -> tuple[list[SessionWear], list[str]]:
    """Read sessions in the order of their start; return them and messages about unreadable parts.

    Replays and empty sessions are skipped. Raises `InputError` if nothing is left.
    """
    problems: list[str] = []
    found: list[tuple[TrialManifest | RecordManifest, Path]] = []
    for folder in folders:
        try:
            why = "only trials and recordings have sensors"
            found.append((read_manifest_of(folder, (TrialManifest, RecordManifest), why), folder))
        except InputError as error:
            problems.append(str(error))
    first: dict[str, Rest] = {}
    sessions = []
    for manifest, folder in sorted(found, key=lambda pair: (pair[0].started, pair[1])):
        try:
            sessions.append(_session(folder, manifest, first))
        except UNREADABLE as error:
            problems.append(f"{folder}: {error}" if str(folder) not in str(error) else str(error))
    if not sessions:
        raise InputError(problems[0] if problems else "there is no session: give a folder with sessions")
    return sessions, problems


def _session(folder: Path, manifest: TrialManifest | RecordManifest, first: dict[str, Rest]) -> SessionWear:
    if isinstance(manifest, TrialManifest):
        lifts = read_usable_lifts(folder).lifts
        rests, areas = _lifts_at_rest(folder, manifest, lifts), _lift_areas(lifts)
        errors = mare_of(lift.re for lift in lifts)
    else:
        lifts, errors = [], None
        rests, areas = _recording_at_rest(folder, manifest), _pose_areas(folder)
    tips = {}
    for serial in manifest.signs:
        rest = rests.get(serial)
        begun = first.setdefault(serial, rest) if rest else None
        area = float(np.median(areas[serial])) if areas.get(serial) else None
        tips[serial] = TipWear(rest.noise if rest else None, _change(begun, rest), area)
    began = datetime.fromisoformat(manifest.started).astimezone(UTC)
    return SessionWear(folder, manifest, began, tips, len(lifts), errors)


def _change(first: Rest | None, rest: Rest | None) -> float | None:
    if first is None or rest is None or first.picture.shape != rest.picture.shape:
        return None
    return float(np.abs(rest.picture - first.picture).mean())


def _lifts_at_rest(folder: Path, manifest: BenchManifest, lifts: Sequence[FinishedLift]) -> dict[str, Rest]:
    """Return each sensor before the grasp in a session's first lift with a readable recording."""
    problem: SessionError | None = None
    for lift in sorted(lifts, key=lambda lift: lift.number):
        try:
            return {serial: lift_at_rest(folder / lift.recording, serial) for serial in manifest.signs}
        except SessionError as error:
            problem = problem or error
    raise problem or SessionError(f"{folder}: no finished lift")


def lift_at_rest(path: Path, serial: str) -> Rest:
    """Return a sensor before the grasp of a recorded lift. Raises `SessionError`."""
    end_ns = phase_times(path)[Phase.GRASP]
    frames = []
    for frame in recorded_frames(path, serial):
        if frame.time_ns >= end_ns or len(frames) == MOST_FRAMES:
            break
        frames.append(frame.image.astype(np.float32))
    if len(frames) < 2:
        raise SessionError(
            f"{path}: {counted(len(frames), 'frame')} of {serial} before the grasp: too few to measure "
            "its noise"
        )
    return Rest(np.mean(frames, axis=0), float(np.std(frames, axis=0, ddof=1).mean()))


def _recording_at_rest(folder: Path, manifest: BenchManifest) -> dict[str, Rest]:
    """Return the sensors without contact in a recording, which stores one mean image of each."""
    pictures = {serial: load_image(folder / reference_file(serial)) for serial in manifest.signs}
    return {
        serial: Rest(picture.astype(np.float32), None)
        for serial, picture in pictures.items()
        if picture is not None
    }


def _lift_areas(lifts: Sequence[FinishedLift]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for lift in lifts:
        for serial, area in lift.contact_area_px.items():
            found.setdefault(serial, []).append(area)
    return found


def _pose_areas(folder: Path) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for pose in read_poses(folder):
        for image in pose.images:
            found.setdefault(image.serial, []).append(image.contact_area_px)
    return found
