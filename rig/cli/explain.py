"""`rig explain`: what the estimator `slip` sees in a turn, as a picture."""

from dataclasses import dataclass
from pathlib import Path

from rig.cli.common import print_result, say
from rig.cli.declared import argument, option
from rig.cli.options import JsonOption, TopicOption
from rig.cli.places import file_place


@dataclass(frozen=True, slots=True)
class ExplainOptions:
    """The frames, and the picture."""

    frames: Path = argument(..., "Folder of images (sorted by name), video, ROS bag, or session of a trial.")
    out: Path = option(..., "The picture, a .png.", callback=file_place)
    background: str | None = option(None, "Frame without contact, as rig estimate takes it.")
    topic: TopicOption = None
    lift: int = option(1, "Of a session: number of the lift.", min=1)
    serial: str | None = option(None, "Of a session: the sensor. Default: the first.")
    pixel_aspect: float | None = option(None, "Width over height of a pixel on the gel.", min=0.5, max=2.0)
    json: JsonOption = False


def explain(options: ExplainOptions) -> None:
    """Draw what slip works with: a contact at its zero and turned farthest, and the gel's slopes in both.

    A slope's direction is its colour, its steepness the brightness. The zero's slopes are turned by the
    estimated angle; what they leave of the later slopes is what a turn does not explain.

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
            raise InputError(f"{options.frames} is a session, which has its own: leave {own} out")
        picture, turn = explained_lift(options.frames, options.lift, options.serial)
    else:
        picture, turn = explained_frames(
            options.frames, options.background, options.pixel_aspect, options.topic
        )
    write_file(options.out, encode_png(picture))
    say(f"turned by {turn.angle_deg:+.2f} deg in {turn.apart_s:.2f} s, image angle")
    figures = {"angle_deg": turn.angle_deg, "sigma_deg": turn.sigma_deg}
    print_result(options.json, {"picture": str(options.out), **figures}, options.out)
