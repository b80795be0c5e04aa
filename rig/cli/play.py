"""`rig play`: a film of one lift, or of anyone's frames."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.common import JsonOption, emit_json, report_broken, say
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rig.frames.estimation import EstimatedSeries
    from rig.report.film import FilmedLift


def play(
    source: Annotated[
        Path,
        typer.Argument(help="Session folder of a trial, or frames of one sensor as rig estimate takes them."),
    ],
    lift: Annotated[
        str | None,
        typer.Option(
            "--lift",
            help="Number in the session (3), object and lift (t1/3, wrench/3), or an unfinished recording "
            "(003.unfinished). Default: the first lift.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="The film: .webm or .mp4 (H.264; .webm where OpenCV has no encoder for it), which browsers "
            "play, .avi (motion JPEG) or .webp (an animated picture). Default: a .webm in this folder, named "
            "after the session and lift, or after the frames.",
            callback=file_place,
        ),
    ] = None,
    beside: Annotated[
        Path | None,
        typer.Option(
            "--beside",
            help="Another session: its lift of the same object and number is shown below, as one with a "
            "reaction to slip below one without.",
        ),
    ] = None,
    background: Annotated[
        str | None,
        typer.Option("--background", help="Of frames: a frame without contact, as rig estimate takes it."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            min=0.01,
            max=10_000,
            help="Of frames: their rate in Hz. Default: a video's own; images 60.",
        ),
    ] = None,
    fps: Annotated[
        float, typer.Option("--fps", min=1, max=120, help="Frames per second of the film.")
    ] = 30.0,
    speed: Annotated[
        float, typer.Option("--speed", min=0.01, max=20, help="1 as it happened, 0.25 four times slower.")
    ] = 1.0,
    width: Annotated[
        int | None, typer.Option("--width", min=320, max=3840, help="Of the film, px. Default: as drawn.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Make a film: fingertips with contact and axes, the camera of a lift, the growing angle curve.

    Needs no display. Browsers play .webm (VP8) and H.264 in .mp4, and show .webp as a picture that moves;
    VLC, mpv and ffmpeg play all of them. The legend stands below the pictures. The angle in frames is that
    of rig estimate.

    Examples:
      rig play sessions/2026-11-21T093000_trial

      rig play sessions/2026-11-21T093000_trial --lift 11 --out lift11.webm

      rig play without --lift toothbrush/1 --beside with_reaction --out caught.webm

      rig play sessions/2026-11-21T093000_trial --lift wrench/1 --speed 0.25 --out slow.avi

      rig play lift.avi --background first:10 --out turn.webm

    """
    from drivers.errors import InputError
    from rig.live.phases import begin_phase
    from rig.report.film import FilmedLift, write_film
    from rig.report.film_file import film_place
    from rig.sessions.manifest import is_session
    from rig.sessions.recording_file import gaps_text

    if is_session(source):
        if background is not None or rate is not None:
            raise InputError(f"{source} is a session, which has its own: leave --background and --rate out")
        shown = _lifts(source, lift, beside)
        name, default = (
            shown[0].lift.name,
            f"{source.resolve().name}_{Path(shown[0].lift.recording).stem}.webm",
        )
    else:
        if lift is not None or beside is not None:
            raise InputError(f"{source} is not a session: leave --lift and --beside out")
        shown = [_frames(source, background, rate)]
        name, default = source.name, f"{source.resolve().stem}_film.webm"
    asked = out or Path(default)
    place = film_place(asked)
    if place.exists() and source.exists() and place.samefile(source):
        raise InputError(f"{place}: is what the film is made of: choose another --out")
    begin_phase("rendering the film")
    film = write_film(shown, place, fps, speed, width)
    width, height = film.size_px
    say(f"{name}: {counted(film.frames, 'frame')} of {width} x {height}, {film.codec}")
    if place != asked:
        say(f"note: the installed OpenCV has no H.264 encoder for .mp4: {place} is written instead")
    if json:
        emit_json(
            {"film": str(film.path), "frames": film.frames, "codec": film.codec, "size_px": [width, height]}
        )
    else:
        print(film.path)
    lifts = [each for each in shown if isinstance(each, FilmedLift) and each.lift.gaps]
    report_broken([gaps_text(f.folder / f.lift.recording, list(f.lift.gaps)) for f in lifts])


def _lifts(session: Path, lift: str | None, beside: Path | None) -> "list[FilmedLift]":
    """Find a lift, and the same one of the session beside."""
    from drivers.errors import InputError
    from rig.report.film import FilmedLift
    from rig.report.session import Lift, find_lift
    from rig.report.unfinished import find_unfinished
    from rig.sessions.manifest import TrialManifest, read_manifest_of

    manifest = read_manifest_of(session, TrialManifest, "only trials have lifts")
    unfinished = None if lift is None else find_unfinished(session, manifest, lift)
    chosen = unfinished or find_lift(session, manifest, lift)
    shown = [FilmedLift(session, manifest, chosen)]
    if beside is not None:
        if not isinstance(chosen, Lift):
            raise InputError("--beside: an unfinished recording has no lift of the same number beside it")
        other = read_manifest_of(beside, TrialManifest, "only trials have lifts")
        same = find_lift(beside, other, f"{chosen.row.object}/{chosen.row.lift}")
        shown.append(FilmedLift(beside, other, same))
    return shown


def _frames(path: Path, background: str | None, rate: float | None) -> "EstimatedSeries":
    """Estimate anyone's frames as `rig estimate` does."""
    from rig.frames.estimation import EstimatedSeries, Estimation
    from rig.frames.series import read_frames
    from rig.tactile.estimators import choose_estimator

    series = read_frames(path, fps=rate)
    done = Estimation(choose_estimator(None, None), background).of_series(series)
    for note in (*series.notes, *(f"warning: {warning}" for warning in done.warnings), done.background):
        say(note)
    return EstimatedSeries(path.name, series, done)
