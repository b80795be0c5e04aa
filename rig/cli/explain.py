"""`rig explain`: draw the stages of the estimator `slip` for one rotation."""

from dataclasses import dataclass
from pathlib import Path

from rig.cli.common import print_result, say
from rig.cli.declared import argument, file_place, option
from rig.cli.options import JsonOption, TopicOption


@dataclass(frozen=True, slots=True)
class ExplainOptions:
    """The frames, and the picture to write."""

    frames: Path = argument(..., "Folder of images (sorted by name), video, ROS bag, or session of a trial.")
    out: Path = option(..., "PNG file to write.", callback=file_place)
    background: str | None = option(None, "Frame without contact, as in rig estimate.")
    topic: TopicOption = None
    lift: int = option(1, "Number of the lift in a session.", min=1)
    serial: str | None = option(None, "Serial of the sensor in a session. Default: the first.")
    pixel_aspect: float | None = option(
        None, "Width of a pixel on the gel divided by its height. Default: 1.", min=0.5, max=2.0
    )
    json: JsonOption = False


def explain(options: ExplainOptions) -> None:
    """Draw how the estimator slip finds an angle, on the two frames with the largest rotation between them.

    The first row shows the frame of angle zero, the slopes of its gel surface, and these slopes turned by the
    estimated angle. The second row shows the frame with the largest angle, its slopes, and the difference
    from the turned slopes, which the rotation does not explain. Hue is the direction of a slope, brightness
    its steepness.

    Examples:
      rig explain frames/ --background empty.png --out stages.png

      rig explain sessions/2026-11-21T093000_trial --lift 3 --out stages.png

    """
    from drivers.errors import InputError
    from drivers.images import encode_png
    from rig.frames.stages import explained_frames, explained_lift
    from rig.sessions.files import write_file
    from rig.sessions.manifest import is_session

    if is_session(options.frames):
        if (options.background, options.pixel_aspect, options.topic) != (None, None, None):
            own = "--background, --pixel-aspect and --topic"
            raise InputError(f"{options.frames} is a session: leave {own} out")
        picture, turn = explained_lift(options.frames, options.lift, options.serial)
    else:
        picture, turn = explained_frames(
            options.frames, options.background, options.pixel_aspect, options.topic
        )
    write_file(options.out, encode_png(picture))
    say(f"turned by {turn.angle_deg:+.2f} deg (image angle) in {turn.apart_s:.2f} s")
    figures = {"angle_deg": turn.angle_deg, "sigma_deg": turn.sigma_deg}
    print_result(options.json, {"picture": str(options.out), **figures}, options.out)
