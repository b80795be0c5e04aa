"""Request and result of an export."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import SessionError
from rig.config import BenchConfig
from rig.sessions.manifest import BenchManifest, RecordManifest, TrialManifest, read_manifest_of
from rig.sessions.records import Lift, PoseRow, accepted_lifts
from rig.sessions.rows import read_usable_lifts, read_usable_poses

CAMERA = "camera"


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """A session and the folder of its export, which exists and is empty.

    lifts: all attempts of a trial. poses: all attempts of a recording. every: every Nth frame of a trial
    becomes a labelled image. left_out: unreadable parts of the session, with reasons.
    """

    session: Path
    out: Path
    manifest: TrialManifest | RecordManifest
    lifts: tuple[Lift, ...] = ()
    poses: tuple[PoseRow, ...] = ()
    every: int = 10
    left_out: tuple[str, ...] = ()

    @property
    def finished_lifts(self) -> list[Lift]:
        return accepted_lifts(self.lifts)

    @property
    def accepted_poses(self) -> list[PoseRow]:
        return [pose for pose in self.poses if pose.accepted]


@dataclass(frozen=True, slots=True)
class Exported:
    """Result of an export: numbers of written items by name, notes, and unreadable parts."""

    counts: dict[str, int]
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


Exporter = Callable[[ExportRequest], Exported]


def export_request(session: Path, out: Path, every: int) -> ExportRequest:
    """Read the session of an export. Raises `SessionError` if it is neither a trial nor a recording."""
    kinds = (TrialManifest, RecordManifest)
    manifest = read_manifest_of(session, kinds, "trials and recordings can be exported")
    if isinstance(manifest, TrialManifest):
        usable = read_usable_lifts(session, checked=True)
        request = ExportRequest(session, out, manifest, usable.rows, (), every, usable.problems)
    else:
        poses, flaws = read_usable_poses(session)
        request = ExportRequest(session, out, manifest, (), tuple(poses), every, tuple(flaws))
    if not request.finished_lifts and not request.accepted_poses:
        raise SessionError(f"{session}: has no finished lift or pose; continue the session with --resume")
    return request


def simulated_mark(manifest: BenchManifest) -> str:
    """Return "SIMULATED " for a simulated session, else ""."""
    return "SIMULATED " if manifest.simulated else ""


def source_name(serial: str, bench: BenchConfig) -> str:
    """Return the name of an image source that is the same on every bench: "camera", or as "finger_b"."""
    fingers = {tactile.serial: f"finger_{tactile.finger.lower()}" for tactile in bench.tactile}
    return CAMERA if serial == bench.require("camera").serial else fingers.get(serial, serial)
