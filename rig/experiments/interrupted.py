"""Evaluate interrupted lifts from their unfinished recordings; they never count as lifts."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S
from drivers.errors import CalibrationError, RigError, SessionError, counted
from rig.experiments.lift_plan import TrialSettings, new_measurement
from rig.lift.marker_truth import NO_ANGLES
from rig.lift.measurement import LiftMeasurement
from rig.lift.recording import lift_angles
from rig.sessions.files import RECORDINGS
from rig.sessions.reading import show_again
from rig.sessions.recorder import FUSED_TOPIC, IMAGE_PREFIX, TRUTH_TOPIC, RecordedAngle
from rig.sessions.recording_file import Gaps, recorded_messages, recording_values
from rig.sessions.unfinished import unfinished_recordings

_ANGLES = {"estimate": FUSED_TOPIC, "markers": TRUTH_TOPIC}
"""Topics of the angles at the end of a recording, by their names for people."""


@dataclass(frozen=True, slots=True, eq=False)
class InterruptedLift:
    """Contents of an unfinished recording, estimated again up to its end.

    recording: file in the session. name: of the lift, for people. phases_ns: start of each phase that was
    reached, by name. begin_ns, end_ns: of the first and the last frame. frames: number over all sources.
    angles: by topic, as in a finished recording. gaps: damaged parts of the recording.
    """

    recording: str
    name: str
    phases_ns: dict[str, int]
    begin_ns: int
    end_ns: int
    frames: int
    angles: dict[str, list[RecordedAngle]]
    gaps: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last, s."""
        return (self.end_ns - self.begin_ns) / NS_PER_S

    def last_deg(self, topic: str) -> float | None:
        """Return the last angle of a topic, None without one."""
        return next(
            (a.angle_deg for a in reversed(self.angles.get(topic, ())) if a.angle_deg is not None), None
        )

    @property
    def text(self) -> str:
        """One line for people: the lift, its progress, and the angles at its end."""
        ends = {what: self.last_deg(topic) for what, topic in _ANGLES.items()}
        angles = [f"{what} {'none' if deg is None else f'{deg:+.1f} deg'}" for what, deg in ends.items()]
        damaged = f"; damaged: {'; '.join(self.gaps)}" if self.gaps else ""
        return (
            f"unfinished, not counted: {self.recording}: {self.name}, {self.seconds:.1f} s, "
            f"{counted(self.frames, 'frame')}, phases {', '.join(self.phases_ns)}; "
            f"at its end {', '.join(angles)}{damaged}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the same as values for JSON output."""
        return {
            "recording": self.recording,
            "lift": self.name,
            "seconds": round(self.seconds, 3),
            "frames": self.frames,
            "phases": list(self.phases_ns),
            **{f"{what}_deg": self.last_deg(topic) for what, topic in _ANGLES.items()},
            "gaps": list(self.gaps),
        }


def interrupted_lifts(folder: Path, settings: TrialSettings) -> tuple[list[InterruptedLift], tuple[str, ...]]:
    """Return the contents of a session's unfinished recordings, and the problems of unreadable ones."""
    lifts: list[InterruptedLift] = []
    problems: list[str] = []
    for path in unfinished_recordings(folder):
        try:
            lifts.append(read_interrupted(path, settings))
        except RigError as error:
            text = str(error)
            problems.append(text if str(path) in text else f"{path}: {text}")
    return lifts, tuple(problems)


def read_interrupted(path: Path, settings: TrialSettings) -> InterruptedLift:
    """Estimate an unfinished recording up to its end. Raises `SessionError` if it contains no frame."""
    times = [t for topic, t, _, _ in recorded_messages(path, gaps=[]) if topic.startswith(IMAGE_PREFIX)]
    if not times:
        raise SessionError(f"{path}: the recording was interrupted before its first frames were written")
    gaps: Gaps = []
    measurement = new_measurement(settings)
    phases_ns = show_again(path, measurement, gaps=gaps)
    values = recording_values(path)
    return InterruptedLift(
        f"{RECORDINGS}/{path.name}",
        f"{values.get('name', 'lift')}, lift {values.get('lift', '?')}",
        phases_ns, min(times), max(times), len(times), _angles(measurement), tuple(gaps),
    )  # fmt: skip


def _angles(measurement: LiftMeasurement) -> dict[str, list[RecordedAngle]]:
    """Return the angles by topic; without those of the markers if the lift ended before their zero."""
    found: dict[str, list[RecordedAngle]] = {}
    try:
        series = measurement.truth.series()
    except CalibrationError:
        series = NO_ANGLES
    for topic, angle in lift_angles(measurement, series):
        found.setdefault(topic, []).append(angle)
    return found
