"""`rig show`: show a stored clip or lift as a whole, on the page of `rig live`."""

from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from drivers.errors import InputError
from rig.cli.common import mark, report_faults, say
from rig.cli.live import PageOptions, begin_showing, stop_event
from rig.cli.options import TopicOption
from rig.declared import argument, option
from rig.terminal.screen import begin_phase, end_phase

if TYPE_CHECKING:
    from rig.frames.estimates import EstimatedSeries


@dataclass(frozen=True)
class StoredOptions:
    stored: Path = argument(
        ..., "Clip, video, folder of images, ROS bag, session of a trial, or recording of a lift (.mcap)."
    )
    lift: str | None = option(None, "Lift of a session, as in rig play. Default: the first lift.")
    topic: TopicOption = None
    fps: float | None = option(
        None,
        "Frame rate of a video or of images, Hz. Default: that of the video or clip; 60 for images.",
        min=0.1,
        max=1000.0,
    )
    estimator: str | None = option(None, "Estimator, as in rig estimate. Default: slip.")
    background: str | None = option(None, "Frame without contact, as in rig estimate.")
    pixel_aspect: float | None = option(
        None, "Width of a pixel on the gel divided by its height, as in rig estimate.", min=0.5, max=2.0
    )
    gel: Path | None = option(
        None, "YAML file of rig calibrate tactile, for a clip: slip computes slopes from its look."
    )


@dataclass(frozen=True)
class ShowOptions(PageOptions, StoredOptions):
    pass


class Estimated(NamedTuple):
    """The estimated clip or recording, its path, and its series, one for each sensor.

    lift_ns: start of the lift of a recording, None for a clip. simulated: whether the frames are simulated.
    """

    path: Path
    series: "list[EstimatedSeries]"
    lift_ns: int | None
    simulated: bool


def show(options: ShowOptions) -> None:
    """Show a stored clip, ROS bag or lift as a whole, on a page with a slider.

    All frames are estimated first; the angles are those of rig estimate. The page then shows the frames with
    the outline of the contact, the angle over time and a list of events, of the last 10 minutes at most.
    Space plays them at the speed of the recording. Of a lift it shows both fingertips, and from the start of
    the lift the angle of the object. Nothing moves. Ctrl-C ends the command.

    Examples:
      rig show clips/pen_2
      rig show lift.avi --background first:10
      rig show sessions/2026-11-21T093000_trial --lift 3
      rig show bag/ --topic /digit_left/image_raw/compressed --no-browser
    """
    from rig.live.stored_clip import stored_history
    from rig.live.watch import WatchPage, watch_address

    at = watch_address(options.watch_at)
    found = estimate_stored(options)
    title = f"{mark(found.simulated)}{found.path}"
    begin_phase("drawing the frames")
    history = stored_history(found.series, found.lift_ns, found.path)
    end_phase()
    with (
        stop_event() as stopped,
        closing(WatchPage(at, title, history=history)) as page,
        ExitStack() as stack,
    ):
        begin_showing(title, page, options.browser, stack)
        stopped.wait()
    say("ended")
    report_faults(one.faults for one in found.series if one.faults)


def estimate_stored(options: ShowOptions) -> Estimated:
    """Estimate a clip, or the fingertips of a lift, and print the figures. Raises `InputError`."""
    from rig.cli.estimate import estimate_all, report_estimate
    from rig.frames.estimates import Estimation
    from rig.frames.of_session import recording_frames
    from rig.frames.series import read_frames
    from rig.sessions.files import is_recording
    from rig.sessions.recording_file import recording_values
    from rig.tactile.estimators import choose_estimator

    path = path_of_lift(options)
    choice = choose_estimator(options.estimator, gel=options.gel)
    run = Estimation(choice, options.background, aspect=options.pixel_aspect)
    if is_recording(path):
        if options.gel is not None or options.fps is not None or options.topic is not None:
            raise InputError(f"{path} contains times and sensors: leave --gel, --fps and --topic out")
        tips = recording_frames(path)
        simulated = recording_values(path).get("simulated") == "SIMULATED"
        found = Estimated(path, list(estimate_all(run, tips)), tips[0].lift_ns, simulated)
    else:
        begin_phase(f"estimating {path}")
        series = read_frames(path, fps=options.fps, topic=options.topic)
        found = Estimated(path, [run.of_series(series)], None, series.simulated)
    for one in found.series:
        report_estimate(f"{mark(found.simulated)}{one.name}", one, run)
    return found


def path_of_lift(options: ShowOptions) -> Path:
    """Return the recording of the chosen lift of a session, else the given path. Raises `InputError`."""
    from rig.report.session import find_lift
    from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of

    path = options.stored
    if is_session(path):
        manifest = read_manifest_of(path, TrialManifest, "only trials have lifts")
        return path / find_lift(path, manifest, options.lift).recording
    if options.lift is not None:
        raise InputError(f"{path} is not a session: leave --lift out")
    return path
