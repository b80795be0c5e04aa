"""`rig label-angle`: lines drawn by hand on a clip's frames become angles with a sigma."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.common import JsonOption, TopicOption, emit_json, say

if TYPE_CHECKING:
    from drivers.types import Image
    from rig.frames.series import FrameSeries
    from rig.labels.angle_clip import FrameChoice
    from rig.labels.angle_lines import DrawnLines


def label_angle(
    clip: Annotated[
        Path,
        typer.Argument(
            help="Folder with frames/, one video or ROS bag, and background.png, a frame without contact."
        ),
    ],
    count: Annotated[
        int | None, typer.Option("--count", min=2, max=200, help="Frames to label. Default: 10.")
    ] = None,
    reference: Annotated[
        int | None,
        typer.Option(
            "--reference",
            min=0,
            help="Frame whose angle is 0. Default: the first of stable full contact, as in rig estimate.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a labels.csv that was not drawn here.")
    ] = False,
    topic: TopicOption = None,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    json: JsonOption = False,
) -> None:
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
    from rig.labels.angle_clip import load_clip
    from rig.labels.angle_lines import LINES, LineLog, read_drawn
    from rig.labels.angle_server import AngleServer, way_to

    series = read_frames(clip_frames(clip), topic=topic)
    drawn = read_drawn(clip / LINES)
    _check_labels(clip / LABELS, drawn, overwrite)
    background = _background(clip, series)
    choice = _choice(series, background, count, reference, drawn)
    to_label = load_clip(clip.resolve().name, series, background, choice)
    log = LineLog(clip / LINES, to_label, drawn)
    with AngleServer(to_label, log) as server, way_to(server.address) as way:
        say(f"draw the lines at {server.address}")
        if browser:
            _open(way)
        while (labels := server.labels_written(timeout_s=0.2)) is None:
            pass
    say(f"{counted(labels, 'label')} written to {clip / LABELS}")
    if json:
        emit_json({"out": str(clip / LABELS), "labels": labels, "frames": len(to_label.frames)})


def _check_labels(labels: Path, drawn: "DrawnLines | None", overwrite: bool) -> None:
    from drivers.errors import InputError

    if labels.exists() and drawn is None and not overwrite:
        raise InputError(f"{labels}: is there already and was not drawn here: --overwrite replaces it")


def _background(clip: Path, series: "FrameSeries") -> "Image":
    from rig.frames.clips import clip_background
    from rig.frames.series import make_background

    own = clip_background(clip)
    background, note = make_background("first:1" if own is None else str(own), series)
    missing = "; rig benchmark clips needs a background.png, a frame without contact" if own is None else ""
    say(note + missing)
    return background


def _choice(
    series: "FrameSeries",
    background: "Image",
    count: int | None,
    reference: int | None,
    drawn: "DrawnLines | None",
) -> "FrameChoice":
    """Return the frames of lines that were begun, else new ones."""
    from drivers.errors import InputError
    from rig.labels.angle_clip import choose_frames
    from rig.labels.angle_lines import LINES

    if drawn is None:
        choice, note = choose_frames(series, background, count or 10, reference)
        say(note)
        return choice
    begun = drawn.choice
    if count not in (None, len(begun.frames)) or reference not in (None, begun.reference):
        raise InputError(
            f"{LINES} was begun with {counted(len(begun.frames), 'frame')} and the reference "
            f"{begun.reference}: leave --count and --reference out to go on, or move the file "
            "away to start again"
        )
    say(f"going on with {counted(len(drawn.clicks), 'click')} from before")
    return begun


def _open(way: str) -> None:
    import webbrowser

    if not webbrowser.open(way):
        say("no browser opened: open that address in one on this computer")
