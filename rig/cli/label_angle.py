"""`rig label-angle`: label angles with a sigma, by lines drawn by hand on the frames of a clip."""

from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError, plural
from rig.cli.common import NO_BROWSER, emit_json, mark, say
from rig.cli.options import JsonOption, TopicOption
from rig.declared import argument, option


@dataclass(frozen=True, slots=True)
class LabelAngleOptions:
    clip: Path = argument(
        ...,
        "Folder with a folder frames/, a video or a ROS bag, and background.png, a frame without contact.",
    )
    count: int | None = option(None, "Number of frames to label. Default: 10.", min=2, max=200)
    reference: int | None = option(
        None,
        "Number of the frame whose angle is 0. Default: the first frame in which the contact has "
        "settled, as in rig estimate.",
        min=0,
    )
    overwrite: bool = option(False, "Replace a labels.csv that this command did not write.")
    topic: TopicOption = None
    browser: bool = option(True, "Open the page in the browser.", "--browser/--no-browser")
    json: JsonOption = False


def label_angle(options: LabelAngleOptions) -> None:
    """Label the rotation of an object in a clip, by a line on each frame that two clicks draw.

    A page on this computer shows each frame enlarged, in two passes. It can also show a grid and the
    difference from the frame without contact. The result is labels.csv in the folder of the clip, for rig
    benchmark clips. The sigma of the labels is computed from the differences between the two passes. Ten
    frames take about ten minutes.

    Every click is stored at once in label_lines.json. You can stop with Ctrl-C at any time; the same command
    continues.

    Examples:
      rig label-angle clips/pen_2
      rig label-angle clips/pen_2 --reference 15 --count 6 --no-browser
    """
    import webbrowser

    from rig.frames.clips import LABELS, TIMES, clip_frames
    from rig.frames.series import read_frames
    from rig.labels.angle_lines import LINES, LineLog, background_of, chosen_frames, load_clip, read_drawn
    from rig.labels.angle_server import AngleServer
    from rig.pages.requests import way_to

    clip, out = options.clip, options.clip / LABELS
    times, drawn = clip / TIMES, read_drawn(clip / LINES)
    series = read_frames(clip_frames(clip), times if times.exists() else None, topic=options.topic)
    if out.exists() and drawn is None and not options.overwrite:
        raise InputError(
            f"{out}: exists, but was not written by rig label-angle; give --overwrite to replace it"
        )
    background, note = background_of(clip, series)
    for text in (*series.notes, note):
        say(text)
    choice, note = chosen_frames(series, background, options.count, options.reference, drawn)
    say(note)
    name = f"{mark(series.simulated)}{clip.resolve().name}"
    to_label = load_clip(name, series, background, choice)
    log = LineLog(clip / LINES, to_label, drawn)
    with AngleServer(to_label, log) as server, way_to(server.address) as way:
        say(f"draw the lines at {server.address}")
        if options.browser and not webbrowser.open(way):
            say(NO_BROWSER)
        while (labels := server.labels_written(timeout_s=0.2)) is None:
            pass
    compared = (
        f"the reference, 0 degrees, is one of them: rig benchmark clips compares the other {labels - 1}"
    )
    say(f"{plural(labels, 'label')} written to {out}\n{compared}")
    if options.json:
        emit_json({"out": str(out), "labels": labels, "frames": len(to_label.frames)})
