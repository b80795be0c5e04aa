"""`rig show`: show a stored clip or lift as a whole, on the page of `rig live`."""

from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from rig.cli.common import mark, report_faults, say
from rig.cli.live import PageOptions, begin_showing, stop_event
from rig.cli.options import TopicOption
from rig.declared import argument, option
from rig.terminal.screen import begin_phase, end_phase

if TYPE_CHECKING:
    from rig.live.state import History
    from rig.tactile.sample import EstimatorFaults


@dataclass(frozen=True)
class ShowOptions(PageOptions):
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
    from rig.live.watch import WatchPage, watch_address

    at = watch_address(options.watch_at)
    title, history, faults = estimate_stored(options)
    with (
        stop_event() as stopped,
        closing(WatchPage(at, title, history=history)) as page,
        ExitStack() as stack,
    ):
        begin_showing(title, page, options.browser, stack)
        stopped.wait()
    say("ended")
    report_faults(faults)


def estimate_stored(options: ShowOptions) -> "tuple[str, History, list[EstimatorFaults]]":
    """Estimate a clip, or the fingertips of a lift, and print the figures.

    Returns its name, its history for the page, and the faults of a user-defined estimator. Raises
    `InputError`.
    """
    from rig.cli.estimate import estimate_all, report_estimate
    from rig.frames.estimates import Estimation
    from rig.frames.of_session import recording_frames
    from rig.frames.series import read_frames
    from rig.live.stored_clip import stored_history
    from rig.report.session import find_lift
    from rig.sessions.files import is_recording
    from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of
    from rig.sessions.recording_file import recording_values
    from rig.tactile.estimators import choose_estimator

    path, lift_ns = options.stored, None
    run = Estimation(
        choose_estimator(options.estimator, gel=options.gel), options.background, aspect=options.pixel_aspect
    )
    if is_session(path):
        manifest = read_manifest_of(path, TrialManifest, "only trials have lifts")
        path /= find_lift(path, manifest, options.lift).recording
    elif options.lift is not None:
        raise InputError(f"{path} is not a session: leave --lift out")
    if is_recording(path):
        if options.gel is not None or options.fps is not None or options.topic is not None:
            raise InputError(f"{path} contains times and sensors: leave --gel, --fps and --topic out")
        tips = recording_frames(path)
        shown, lift_ns = list(estimate_all(run, tips)), tips[0].lift_ns
        simulated = recording_values(path).get("simulated") == "SIMULATED"
    else:
        begin_phase(f"estimating {path}")
        series = read_frames(path, fps=options.fps, topic=options.topic)
        shown, simulated = [run.of_series(series)], series.simulated
    for one in shown:
        report_estimate(f"{mark(simulated)}{one.name}", one, run)
    begin_phase("drawing the frames")
    history = stored_history(shown, lift_ns, path)
    end_phase()
    return f"{mark(simulated)}{path}", history, [one.faults for one in shown if one.faults]
