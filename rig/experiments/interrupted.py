"""Lifts that were interrupted, from their unfinished recordings; they never count as lifts."""

from dataclasses import dataclass
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import CalibrationError, RigError, SessionError
from rig.experiments.lift_plan import TrialSettings, new_measurement
from rig.lift.marker_truth import NO_ANGLES
from rig.lift.measurement import LiftMeasurement
from rig.lift.recording import lift_angles
from rig.sessions.files import RECORDINGS
from rig.sessions.reading import show_again
from rig.sessions.recorder import IMAGE_PREFIX, RecordedAngle
from rig.sessions.recording_file import Gaps, recorded_messages, recording_values
from rig.sessions.unfinished import unfinished_recordings


@dataclass(frozen=True, slots=True, eq=False)
class InterruptedLift:
    """What an unfinished recording holds, estimated again up to its end.

    recording: file in the session. name: of the lift for people. phases_ns: when each phase began that was
    reached, by name. begin_ns, end_ns: of the first and the last frame. frames: of all sources. angles: by
    topic, as a finished recording has them. gaps: what of the recording is damaged.
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


def interrupted_lifts(folder: Path, settings: TrialSettings) -> tuple[list[InterruptedLift], tuple[str, ...]]:
    """Return what a session's unfinished recordings hold, and which of them cannot be read, and why."""
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
    """Estimate an unfinished recording up to its end. Raises `SessionError` if it holds no frame."""
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
    """Return the angles by topic; without the markers' if the lift was interrupted before their zero."""
    found: dict[str, list[RecordedAngle]] = {}
    try:
        series = measurement.truth.series()
    except CalibrationError:
        series = NO_ANGLES
    for topic, angle in lift_angles(measurement, series):
        found.setdefault(topic, []).append(angle)
    return found
