"""The tactile frames of a session or a recording as one frame series per sensor."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from pathlib import Path

from calibration.gel.look import GelLook
from drivers.errors import InputError, unknown_name
from drivers.types import Image
from protocols.observer import Phase
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.recorder import seconds_text
from rig.sessions.recording_file import recording_values
from rig.sessions.rows import read_usable_lifts
from rig.tactile.contact.background import mean_background


@dataclass(frozen=True, slots=True, eq=False)
class SessionSeries:
    """One fingertip in one lift: its sign, its frame without contact, and its frames from phase A on.

    aspect: width over height of a pixel on the gel, None if unknown. lift_ns: start of the lift. gel: look
    with which the session computed slopes.
    """

    lift: str
    serial: str
    sign: int
    aspect: float | None
    background: Image
    frames: FrameSeries
    lift_ns: int | None = None
    gel: GelLook | None = None


def session_frames(folder: Path) -> tuple[list[SessionSeries], tuple[str, ...]]:
    """Return the fingertips of a trial's accepted lifts, and the problems of unreadable ones.

    Raises `SessionError` if none is readable.
    """
    manifest = read_manifest_of(
        folder,
        TrialManifest,
        "it has no lifts, and its images are not a clip: they show different sensors or poses",
    )
    usable = read_usable_lifts(folder, checked=True)
    aspects, gels = manifest.config.pixel_aspects(), manifest.config.calibrations.gel
    series = [
        _series(folder / row.recording, serial, sign, aspects.get(serial), gels.get(serial))
        for row in usable.lifts
        for serial, sign in manifest.signs.items()
    ]
    return series, usable.problems


def recording_frames(recording: Path) -> list[SessionSeries]:
    """Return the fingertips of one recording, which may be outside its session.

    The pixel aspect is known only if the recording is in its session. Raises `SessionError`, or `InputError`
    if the file is not a recording of a lift.
    """
    session = recording.absolute().parent.parent
    if is_session(session):
        manifest = read_manifest_of(session, TrialManifest, "it has no lifts")
        signs, aspects = dict(manifest.signs), manifest.config.pixel_aspects()
        gels = manifest.config.calibrations.gel
    else:
        text = recording_values(recording).get("signs", "")
        signs, aspects, gels = {name: int(sign) for name, sign in _SIGNS.findall(text)}, {}, {}
    if not signs:
        raise InputError(f"{recording}: does not name its fingertips: give a recording of rig trial")
    return [
        _series(recording, serial, sign, aspects.get(serial), gels.get(serial))
        for serial, sign in signs.items()
    ]


_SIGNS = re.compile(r"(?:^|, )(.+?) on finger \w+ ([+-]1)(?=, |$)")
"""Serial and sign of each fingertip, as `rig.experiments.lift_attempt` writes them into a recording."""


def of_sensor(tips: Sequence[SessionSeries], serial: str | None) -> Sequence[SessionSeries]:
    """Return the series of one sensor, or all if `serial` is None. Raises `InputError` if unknown."""
    found = [tip for tip in tips if serial in (None, tip.serial)]
    if not found:
        raise unknown_name("sensor", str(serial), dict.fromkeys(tip.serial for tip in tips))
    return found


def _series(
    recording: Path, serial: str, sign: int, aspect: float | None, gel: GelLook | None
) -> SessionSeries:
    phases = phase_times(recording)
    grasp_ns = phases.get(Phase.GRASP, 0)
    frames = recorded_frames(recording, serial)
    reference = [f.image for f in takewhile(lambda frame: frame.time_ns < grasp_ns, frames)]
    if not reference:
        raise InputError(f"{recording}: no frames of {serial} before the grasp: give another recording")

    series = FrameSeries(str(recording), partial(_frames_after, recording, serial, grasp_ns))
    background = mean_background(reference)
    lift_ns = phases.get(Phase.LIFT)
    return SessionSeries(recording.stem, serial, sign, aspect, background, series, lift_ns, gel)


def _frames_after(recording: Path, serial: str, grasp_ns: int) -> Iterator[TimedFrame]:
    for frame in recorded_frames(recording, serial):
        if frame.time_ns >= grasp_ns:
            time = FrameTime(seconds_text(frame.time_ns), frame.time_ns)
            yield TimedFrame(f"frame {frame.sequence}", time, frame.image)
