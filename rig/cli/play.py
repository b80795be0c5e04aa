"""`rig play`: a film of one lift."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, emit_json, report_broken, say
from rig.cli.places import file_place


def play(
    session: Annotated[Path, typer.Argument(help="Session folder of a trial.")],
    lift: Annotated[
        str,
        typer.Option(
            "--lift",
            help="Number in the session (3), object and lift (t1/3, wrench/3), or an unfinished recording "
            "(003.unfinished).",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="The film: .webm (plays in browsers), .mp4 (MPEG-4), .avi (motion JPEG) or .webp (an "
            "animated picture).",
            callback=file_place,
        ),
    ],
    beside: Annotated[
        Path | None,
        typer.Option(
            "--beside",
            help="Another session: its lift of the same object and number is shown below, as one with a "
            "reaction to slip below one without.",
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
    """Render a lift: both fingertips with contact and axes, the camera, and the growing angle curve.

    Needs no display. Browsers play .webm (VP8), and show .webp as a picture that moves; VLC, mpv and
    ffmpeg play the other three. The legend stands below the pictures.

    Examples:
      rig play sessions/2026-11-21T093000_trial --lift 11 --out lift11.webm

      rig play without --lift toothbrush/1 --beside with_reaction --out caught.webm

      rig play sessions/2026-11-21T093000_trial --lift wrench/1 --speed 0.25 --out slow.avi

      rig play sessions/2026-11-21T093000_trial --lift 11 --fps 10 --width 1000 --out lift11.webp

    """
    from drivers.errors import InputError
    from rig.live.phases import begin_phase
    from rig.report.film import FilmedLift, write_film
    from rig.report.session import Lift, find_lift
    from rig.report.unfinished import find_unfinished
    from rig.sessions.manifest import TrialManifest, read_manifest_of
    from rig.sessions.recording_file import gaps_text

    manifest = read_manifest_of(session, TrialManifest, "only trials have lifts")
    unfinished = find_unfinished(session, manifest, lift)
    chosen = unfinished or find_lift(session, manifest, lift)
    shown = [FilmedLift(session, manifest, chosen)]
    if beside is not None:
        if not isinstance(chosen, Lift):
            raise InputError("--beside: an unfinished recording has no lift of the same number beside it")
        other = read_manifest_of(beside, TrialManifest, "only trials have lifts")
        same = find_lift(beside, other, f"{chosen.row.object}/{chosen.row.lift}")
        shown.append(FilmedLift(beside, other, same))
    begin_phase("rendering the film")
    film = write_film(shown, out, fps, speed, width)
    width, height = film.size_px
    say(f"{chosen.name}: {film.frames} frames of {width} x {height}, {film.codec}")
    if film.codec == "mp4v":
        say(f"note: browsers do not play MPEG-4 in .mp4; --out {out.with_suffix('.webm')} plays there")
    if json:
        emit_json(
            {"film": str(film.path), "frames": film.frames, "codec": film.codec, "size_px": [width, height]}
        )
    else:
        print(film.path)
    report_broken([gaps_text(f.folder / f.lift.recording, list(f.lift.gaps)) for f in shown if f.lift.gaps])
