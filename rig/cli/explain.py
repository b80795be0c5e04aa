"""`rig explain`: draw the stages of the estimator `slip` for one rotation."""

from dataclasses import dataclass
from pathlib import Path

from rig.cli.common import print_result, say
from rig.cli.options import JsonOption, TopicOption
from rig.declared import argument, file_place, option


@dataclass(frozen=True, slots=True)
class ExplainOptions:
    frames: Path = argument(..., "Folder of images (sorted by name), video, ROS bag, or session of a trial.")
    out: Path = option(..., "PNG file to write.", callback=file_place)
    background: str | None = option(None, "Frame without contact, as in rig estimate.")
    topic: TopicOption = None
    lift: int = option(1, "Number of the lift in a session.", min=1)
    serial: str | None = option(None, "Serial of the sensor in a session. Default: the first.")
    pixel_aspect: float | None = option(
        None, "Width of a pixel on the gel divided by its height. Default: 1.", min=0.5, max=2.0
    )
    height: Path | None = option(
        None,
        "Draw depth and normals instead, by this file of rig calibrate tactile, and write both beside the "
        "picture (.npz: depth_mm, normals; every second pixel).",
    )
    json: JsonOption = False


def explain(options: ExplainOptions) -> None:
    """Draw how the estimator slip finds an angle, on the two frames with the largest rotation between them.

    The first row shows the features of the frame of angle zero: its difference from the frame without
    contact, its texture, weighted by the network, and the curvature of the gel. The second row shows the
    frame, the slopes of its gel surface, and these slopes turned by the estimated angle. The third row shows
    the frame with the largest angle, its slopes, and the difference from the turned slopes, which the
    rotation does not explain. Hue is a direction, brightness a steepness or strength; in the first and last
    picture of the first row grey is 0.

    Examples:
      rig explain frames/ --background empty.png --out stages.png
      rig explain sessions/2026-11-21T093000_trial --lift 3 --out stages.png
      rig explain frames/ --background empty.png --height calibrations/tactile-D20641.yaml --out height.png
    """
    import io

    import numpy as np

    from drivers.errors import InputError
    from drivers.images import encode_png
    from rig.frames.gel_height import read_gel_map
    from rig.frames.stages import explained_frames, explained_lift, height_picture, stages_picture
    from rig.sessions.files import write_file
    from rig.sessions.manifest import is_session

    if is_session(options.frames):
        if (options.background, options.pixel_aspect, options.topic) != (None, None, None):
            own = "--background, --pixel-aspect and --topic"
            raise InputError(f"{options.frames} is a session: leave {own} out")
        turn = explained_lift(options.frames, options.lift, options.serial)
    else:
        turn = explained_frames(options.frames, options.background, options.pixel_aspect, options.topic)
    figures: dict[str, object] = {"angle_deg": turn.angle_deg, "sigma_deg": turn.sigma_deg}
    if options.height is None:
        picture = stages_picture(turn)
    else:
        gel = read_gel_map(options.height)
        picture, shape = height_picture(turn, gel)
        arrays = io.BytesIO()
        np.savez_compressed(arrays, depth_mm=shape.depth_mm, normals=shape.normals)
        write_file(options.out.with_suffix(".npz"), arrays.getvalue())
        across, down = (px * mm for px, mm in zip(turn.shift_px, gel.mm_per_px, strict=True))
        figures["shift_mm"] = [across, down]
        say(f"moved by {across:+.2f} mm to the right, {down:+.2f} mm down")
    write_file(options.out, encode_png(picture))
    say(f"turned by {turn.angle_deg:+.2f} deg (image angle) in {turn.apart_s:.2f} s")
    print_result(options.json, {"picture": str(options.out), **figures}, options.out)
