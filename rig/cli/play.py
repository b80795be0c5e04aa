"""`rig play`: make a film of one lift, or of your own frames."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError, plural
from rig.cli.common import print_result, report_broken, say
from rig.cli.options import JsonOption, TopicOption
from rig.declared import argument, file_place, option
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.frames.estimates import EstimatedSeries
    from rig.report.film import Filmed


@dataclass(frozen=True, slots=True)
class PlayOptions:
    source: Path = argument(
        ..., "Session folder of a trial, or frames of one sensor in any form that rig estimate reads."
    )
    lift: str | None = option(
        None,
        "Lift of a session: its number (3), or object and lift (t1/3, wrench/3). Default: the first lift.",
    )
    beside: Path | None = option(
        None,
        "Second session: its lift of the same object and number is shown below, for example with a "
        "reaction to slip.",
    )
    background: str | None = option(None, "For frames: frame without contact, as in rig estimate.")
    rate: float | None = option(
        None,
        "For frames: frame rate in Hz. Default: that of a video; 60 for images.",
        min=0.01,
        max=10_000,
    )
    topic: TopicOption = None
    out: Path | None = option(
        None,
        "Film to write: .webm, .mp4 (H.264; a .webm if the installed OpenCV cannot encode it), .avi (motion "
        "JPEG) or .webp (animated picture). Default: a .webm in this folder, named after the session and "
        "lift, or after the frames.",
        callback=file_place,
    )
    fps: float = option(30.0, "Frames per second of the film.", min=1, max=120)
    speed: float = option(1.0, "Speed: 1 is real time, 0.25 is four times slower.", min=0.01, max=20)
    width: int | None = option(
        None, "Width of the film in px. Default: as drawn, without scaling.", min=320, max=3840
    )
    json: JsonOption = False


def play(options: PlayOptions) -> None:
    """Make a film of a lift or of your own frames, with contact, axes and the angle over time.

    The film of a lift also shows the external camera. The legend is below the pictures. For frames, the angle
    is that of rig estimate.

    No display is needed. Browsers play .webm (VP8) and .mp4 (H.264), and show .webp as an animated picture.
    VLC, mpv and ffmpeg play all formats.

    Examples:
      rig play sessions/2026-11-21T093000_trial
      rig play without --lift toothbrush/1 --beside with_reaction --out caught.webm
      rig play sessions/2026-11-21T093000_trial --lift wrench/1 --speed 0.25 --out slow.avi
      rig play lift.avi --background first:10 --out turn.webm
    """
    from rig.report.film import film_place, write_film
    from rig.sessions.manifest import is_session
    from rig.sessions.recording_file import gaps_text

    source = options.source
    if is_session(source):
        lifts = _lifts(options)
        name, recording = lifts[0][2].title, Path(lifts[0][2].recording).stem
        shown, default = lifts, Path(f"{source.resolve().name}_{recording}.webm")
    elif options.lift is not None or options.beside is not None:
        raise InputError(f"{source} is not a session: leave --lift and --beside out")
    else:
        lifts, shown = [], [_frames(options)]
        name, default = source.name, Path(f"{source.resolve().stem}_film.webm")
    asked = options.out or default
    place = film_place(asked)
    if place.exists() and options.source.exists() and place.samefile(options.source):
        raise InputError(f"{place}: is the source of the film; choose another --out")
    begin_phase("rendering the film")
    done = write_film(shown, place, options.fps, options.speed, options.width)
    width, height = done.size_px
    say(f"{name}: {plural(done.frames, 'frame')} of {width} x {height}, {done.codec}")
    if place != asked:
        say(f"note: the installed OpenCV has no H.264 encoder for .mp4: {place} is written instead")
    figures = {"frames": done.frames, "codec": done.codec, "size_px": [width, height]}
    print_result(options.json, {"film": str(done.path), **figures}, done.path)
    read = [(folder / lift.recording, lift.notes) for folder, _, lift in lifts]
    report_broken([gaps_text(recording, list(gaps)) for recording, gaps in read if gaps])


def _lifts(options: PlayOptions) -> "list[Filmed]":
    """Return a lift and, with --beside, the lift of the same object and number of the second session."""
    from rig.report.session import find_lift
    from rig.sessions.manifest import TrialManifest, read_manifest_of

    if (options.background, options.rate, options.topic) != (None, None, None):
        raise InputError(f"{options.source} is a session: leave --background, --rate and --topic out")
    manifest = read_manifest_of(options.source, TrialManifest, "only trials have lifts")
    chosen = find_lift(options.source, manifest, options.lift)
    shown: list[Filmed] = [(options.source, manifest, chosen)]
    if options.beside is not None:
        other = read_manifest_of(options.beside, TrialManifest, "only trials have lifts")
        same = find_lift(options.beside, other, f"{chosen.object}/{chosen.lift}")
        shown.append((options.beside, other, same))
    return shown


def _frames(options: PlayOptions) -> "EstimatedSeries":
    from rig.frames.estimates import Estimation
    from rig.frames.series import read_frames
    from rig.tactile.estimators import choose_estimator

    series = read_frames(options.source, fps=options.rate, topic=options.topic)
    done = Estimation(choose_estimator(None, None), options.background).of_series(series)
    for note in (*series.notes, *(f"warning: {warning}" for warning in done.warnings), done.background):
        say(note)
    return done
