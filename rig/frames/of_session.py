"""The tactile frames of a session, lift by lift and sensor by sensor, as anyone's frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.types import Image
from protocols.observer import Phase
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.recorder import seconds_text
from rig.sessions.rows import read_usable_lifts
from rig.tactile.contact.background import mean_background


@dataclass(frozen=True, slots=True, eq=False)
class SessionSeries:
    """One fingertip in one lift: its sign, its frame without contact, its frames from phase A on.

    aspect: width over height of its pixels on the gel, None where unknown. lift_ns: when the lift began.
    """

    lift: str
    serial: str
    sign: int
    aspect: float | None
    background: Image
    frames: FrameSeries
    lift_ns: int | None = None


def session_frames(folder: Path) -> tuple[list[SessionSeries], tuple[str, ...]]:
    """Return the fingertips of a trial's accepted lifts, and what is wrong with those that cannot be read.

    Raises `SessionError` where none can be.
    """
    manifest = read_manifest_of(folder, TrialManifest, "it has no lifts; give its images")
    usable, aspects = read_usable_lifts(folder, checked=True), manifest.config.pixel_aspects()
    series = [
        _series(folder / row.recording, serial, sign, aspects.get(serial))
        for row in usable.lifts
        for serial, sign in manifest.signs.items()
    ]
    return series, usable.problems


def _series(recording: Path, serial: str, sign: int, aspect: float | None) -> SessionSeries:
    phases = phase_times(recording)
    grasp_ns = phases[Phase.GRASP]
    reference = [f.image for f in recorded_frames(recording, serial) if f.time_ns < grasp_ns]

    def read() -> Iterator[TimedFrame]:
        for frame in recorded_frames(recording, serial):
            if frame.time_ns >= grasp_ns:
                time = FrameTime(seconds_text(frame.time_ns), frame.time_ns)
                yield TimedFrame(f"frame {frame.sequence}", time, frame.image)

    frames = FrameSeries(str(recording), read)
    background = mean_background(reference)
    return SessionSeries(recording.stem, serial, sign, aspect, background, frames, phases[Phase.LIFT])
