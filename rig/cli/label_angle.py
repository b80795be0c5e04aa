"""`rig label-angle`: lines drawn by hand on a clip's frames become angles with a sigma."""

from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError, counted
from rig.cli.common import emit_json, say
from rig.cli.declared import argument, option
from rig.cli.options import JsonOption, TopicOption


@dataclass(frozen=True, slots=True)
class LabelAngleOptions:
    """The clip, and the frames to label."""

    clip: Path = argument(
        ..., "Folder with frames/, one video or ROS bag, and background.png, a frame without contact."
    )
    count: int | None = option(None, "Frames to label. Default: 10.", min=2, max=200)
    reference: int | None = option(
        None, "Frame whose angle is 0. Default: the first of stable full contact, as in rig estimate.", min=0
    )
    overwrite: bool = option(False, "Replace a labels.csv that was not drawn here.")
    topic: TopicOption = None
    browser: bool = option(True, "Open the page in the browser.", "--browser/--no-browser")
    json: JsonOption = False


def label_angle(options: LabelAngleOptions) -> None:
    """Label by hand how far an object has turned: two clicks per frame make a line, in two passes.

    A page on this computer shows each frame enlarged; on request its difference from the frame without
    contact, and a grid. It writes labels.csv into the clip's folder, as rig benchmark clips reads it; the
    sigma is from how far the two passes agree. Every click is kept at once in label_lines.json: stop with
    Ctrl-C when you like, the same command goes on. Ten frames take about ten minutes.

    Examples:
      rig label-angle clips/pen_2

      rig label-angle clips/pen_2 --reference 15 --count 6 --no-browser

    """
    from rig.frames.clips import LABELS, clip_frames
    from rig.frames.series import read_frames
    from rig.labels.angle_clip import background_of, load_clip
    from rig.labels.angle_lines import LINES, LineLog, chosen_frames, read_drawn
    from rig.labels.angle_server import AngleServer, way_to

    clip, out = options.clip, options.clip / LABELS
    series, drawn = read_frames(clip_frames(clip), topic=options.topic), read_drawn(clip / LINES)
    if out.exists() and drawn is None and not options.overwrite:
        raise InputError(f"{out}: is there already and was not drawn here: --overwrite replaces it")
    background, note = background_of(clip, series)
    say(note)
    choice, note = chosen_frames(series, background, options.count, options.reference, drawn)
    say(note)
    to_label = load_clip(clip.resolve().name, series, background, choice)
    log = LineLog(clip / LINES, to_label, drawn)
    with AngleServer(to_label, log) as server, way_to(server.address) as way:
        say(f"draw the lines at {server.address}")
        if options.browser:
            _open(way)
        while (labels := server.labels_written(timeout_s=0.2)) is None:
            pass
    say(f"{counted(labels, 'label')} written to {out}")
    if options.json:
        emit_json({"out": str(out), "labels": labels, "frames": len(to_label.frames)})


def _open(way: str) -> None:
    import webbrowser

    if not webbrowser.open(way):
        say("no browser opened: open that address in one on this computer")
