"""What an export is told, and what it says it did."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import SessionError
from rig.config import BenchConfig
from rig.sessions.manifest import BenchManifest, RecordManifest, TrialManifest, read_manifest_of
from rig.sessions.records import FinishedLift, LiftRow, PoseRow, finished
from rig.sessions.rows import read_usable_lifts, read_usable_poses

CAMERA = "camera"


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """A session and where its export goes: a folder that exists and is empty.

    lifts, poses: all attempts of a trial, of a recording; the other one has none. every: of a trial's
    frames, each so-many-th becomes a labelled image. left_out: what of the session cannot be read, and why.
    """

    session: Path
    out: Path
    manifest: TrialManifest | RecordManifest
    lifts: tuple[LiftRow, ...] = ()
    poses: tuple[PoseRow, ...] = ()
    every: int = 10
    left_out: tuple[str, ...] = ()

    @property
    def finished_lifts(self) -> list[FinishedLift]:
        """Lifts that count."""
        return finished(self.lifts)

    @property
    def accepted_poses(self) -> list[PoseRow]:
        """Poses that count."""
        return [pose for pose in self.poses if pose.accepted]


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: how many of what, what a user of it should know, what could not be read."""

    counts: dict[str, int]
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


Exporter = Callable[[ExportRequest], Exported]


def export_request(session: Path, out: Path, every: int) -> ExportRequest:
    """Read what an export starts from. Raises `SessionError` for what is no trial or recording."""
    kinds = (TrialManifest, RecordManifest)
    manifest = read_manifest_of(session, kinds, "trials and recordings can be exported")
    if isinstance(manifest, TrialManifest):
        usable = read_usable_lifts(session, checked=True)
        request = ExportRequest(
            session, out, manifest, lifts=usable.rows, left_out=usable.problems, every=every
        )
    else:
        poses, flaws = read_usable_poses(session)
        request = ExportRequest(
            session, out, manifest, poses=tuple(poses), left_out=tuple(flaws), every=every
        )
    if not request.finished_lifts and not request.accepted_poses:
        raise SessionError(f"{session}: nothing is finished yet; continue it with --resume first")
    return request


def simulated_mark(manifest: BenchManifest) -> str:
    """Return "SIMULATED " for a simulated session, else nothing."""
    return "SIMULATED " if manifest.simulated else ""


def source_name(serial: str, bench: BenchConfig) -> str:
    """Return the name of a source of images, the same for each bench: "camera", or its finger, "finger_b"."""
    fingers = {tactile.serial: f"finger_{tactile.finger.lower()}" for tactile in bench.tactile}
    return CAMERA if serial == bench.camera.serial else fingers.get(serial, serial)
