"""`rig explain`: what the estimator `slip` sees in a turn, as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, TopicOption, emit_json, say
from rig.cli.places import file_place


def explain(
    frames: Annotated[
        Path, typer.Argument(help="Folder of images (sorted by name), video, ROS bag, or session of a trial.")
    ],
    out: Annotated[Path, typer.Option("--out", help="The picture, a .png.", callback=file_place)],
    background: Annotated[
        str | None, typer.Option("--background", help="Frame without contact, as rig estimate takes it.")
    ] = None,
    topic: TopicOption = None,
    lift: Annotated[int, typer.Option("--lift", min=1, help="Of a session: number of the lift.")] = 1,
    serial: Annotated[
        str | None, typer.Option("--serial", help="Of a session: the sensor. Default: the first.")
    ] = None,
    pixel_aspect: Annotated[
        float | None,
        typer.Option("--pixel-aspect", min=0.5, max=2.0, help="Width over height of a pixel on the gel."),
    ] = None,
    json: JsonOption = False,
) -> None:
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

    if is_session(frames):
        if background is not None or pixel_aspect is not None or topic is not None:
            own = "--background, --pixel-aspect and --topic"
            raise InputError(f"{frames} is a session, which has its own: leave {own} out")
        picture, turn = explained_lift(frames, lift, serial)
    else:
        picture, turn = explained_frames(frames, background, pixel_aspect, topic)
    write_file(out, encode_png(picture))
    say(f"turned by {turn.angle_deg:+.2f} deg in {turn.apart_s:.2f} s, image angle")
    if json:
        emit_json({"picture": str(out), "angle_deg": turn.angle_deg, "sigma_deg": turn.sigma_deg})
    else:
        print(out)
